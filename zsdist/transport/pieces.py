"""Large payloads in pieces: the sender keeps a payload, and each receiver asks for its pieces at its own pace.

zenoh's dropping mode loses a message as soon as one of its fragments has waited for 51 ms, so a payload that a link
cannot carry in that time never arrives as one message. A piece fits into one packet, and only a few are on their way
to a receiver at a time. A lost piece is asked for again.
"""

import hashlib
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Self

PIECE_BYTES = 48 * 1024  # fits into one packet of 64 KiB with its key
WINDOW = 8  # most pieces on their way to one receiver of one payload
LOST_AFTER_S = 1.0  # age at which a piece is asked for again; it doubles with each loss
LOST_AFTER_MAX_S = 4.0
STALLED_AFTER_S = 20.0  # time without a new piece after which a receiver gives up
GONE_AFTER_S = 2.0  # the same after a sender has said that it does not have the payload
KEPT_S = 10.0  # time since the last question for which a sender keeps a payload that it has replaced
KEPT = 4  # most payloads of one key that a sender keeps
DELIVER_AGAIN_S = 0.05

_MANIFEST = struct.Struct("<8sQ")
_QUESTION = struct.Struct("<8sI")
_EVERYTHING = 2**32 - 1  # index with which a receiver says that it has everything


class Manifest(NamedTuple):
    """Description of a payload that is to be fetched.

    Attributes:
        digest: first bytes of the payload's SHA-256.
        size: size of the payload in bytes.
    """

    digest: bytes
    size: int

    @classmethod
    def of(cls, payload: bytes) -> Self:
        """Return the manifest of a payload."""
        return cls(_digest(payload), len(payload))

    @classmethod
    def unpack(cls, data: bytes) -> Self | None:
        """Return the manifest in an attachment; None if it is none."""
        return cls(*_MANIFEST.unpack(data)) if len(data) == _MANIFEST.size else None

    def pack(self) -> bytes:
        """Return the manifest as an attachment."""
        return _MANIFEST.pack(*self)

    @property
    def pieces(self) -> int:
        """Number of pieces."""
        return -(-self.size // PIECE_BYTES)


@dataclass
class _Kept:
    payload: bytes
    asked_s: float


class PieceStore:
    """Payloads of a sender by key and digest; the threads of a transport share it.

    Args:
        release: whether a payload is forgotten once a receiver has everything: it has one receiver.
        clock: monotonic clock in seconds.
    """

    def __init__(self, *, release: bool, clock: Callable[[], float] = time.monotonic) -> None:
        self._release, self._clock = release, clock
        self._kept: dict[str, dict[bytes, _Kept]] = {}
        self._lock = threading.Lock()

    def keep(self, key: str, payload: bytes) -> Manifest | None:
        """Keep the newest payload of a key, beside older ones that are still being fetched.

        Returns:
            The manifest to send; None, and nothing is kept, while `KEPT` older ones are being fetched.
        """
        manifest, now = Manifest.of(payload), self._clock()
        with self._lock:
            older = self._kept.get(key, {})
            kept = {digest: held for digest, held in older.items() if now - held.asked_s < KEPT_S}
            if manifest.digest not in kept and len(kept) >= KEPT:
                return None
            self._kept[key] = kept | {manifest.digest: _Kept(payload, now)}
        return manifest

    def answer(self, key: str, question: bytes) -> bytes | None:
        """Return the answer to a receiver's question.

        Returns:
            The piece; nothing where there is no such payload or piece; None where no answer is expected.
        """
        if len(question) != _QUESTION.size:
            return None
        digest, index = _QUESTION.unpack(question)
        with self._lock:
            kept = self._kept.get(key, {}).get(digest)
            if kept is None:
                return b""
            kept.asked_s = self._clock()
            if index == _EVERYTHING and self._release:
                del self._kept[key][digest]
        return None if index == _EVERYTHING else kept.payload[index * PIECE_BYTES : (index + 1) * PIECE_BYTES]


class Assembly:
    """Pieces of one payload as they arrive, and the decision which to ask for; it uses no socket and no clock.

    Args:
        manifest: manifest of the payload.
        now: time, seconds.
    """

    def __init__(self, manifest: Manifest, now: float) -> None:
        self.manifest = manifest
        self._missing = deque(range(manifest.pieces))
        self._asked: dict[int, float] = {}  # pieces on their way, with the time at which they count as lost
        self._pieces: dict[int, bytes] = {}
        self._window, self._lost_after_s = WINDOW, LOST_AFTER_S
        self._give_up_s = now + STALLED_AFTER_S

    @property
    def complete(self) -> bool:
        """True once all pieces are there."""
        return len(self._pieces) == self.manifest.pieces

    def stalled(self, now: float) -> bool:
        """Return whether no new piece has come for `STALLED_AFTER_S`, or the sender no longer has the payload."""
        return now >= self._give_up_s

    def due(self, now: float) -> list[int]:
        """Return the pieces to ask for now; those that count as lost are among them."""
        lost = [index for index, until_s in self._asked.items() if until_s <= now]
        for index in lost:
            del self._asked[index]
        if lost:
            self._missing.extendleft(lost)
            self._window = max(1, self._window // 2)
            self._lost_after_s = min(2 * self._lost_after_s, LOST_AFTER_MAX_S)
        asked = []
        while self._missing and len(self._asked) < self._window:
            index = self._missing.popleft()
            if index not in self._pieces:
                self._asked[index] = now + self._lost_after_s
                asked.append(index)
        return asked

    @property
    def next_wake_s(self) -> float:
        """Time at which a piece counts as lost, or the payload."""
        return min([self._give_up_s, *self._asked.values()])

    def add(self, index: int, piece: bytes, now: float) -> None:
        """Add an answer: a piece, or nothing where the sender no longer has the payload.

        A piece of a wrong size, or one that is there already, is ignored. Another sender may still have the payload
        that one lacks, so it counts as lost only after `GONE_AFTER_S`.
        """
        if not piece:
            self._give_up_s = min(self._give_up_s, now + GONE_AFTER_S)
        size = min(PIECE_BYTES, self.manifest.size - index * PIECE_BYTES)
        if index in self._pieces or len(piece) != size:
            return
        self._asked.pop(index, None)
        self._pieces[index] = piece
        self._give_up_s = now + STALLED_AFTER_S
        if len(self._pieces) % WINDOW == 0:
            self._window = min(self._window + 1, WINDOW)

    def payload(self) -> bytes | None:
        """Return the complete payload; None if it is not the one of the manifest."""
        payload = b"".join(self._pieces[index] for index in range(self.manifest.pieces))
        return payload if _digest(payload) == self.manifest.digest else None


Ask = Callable[[str, bytes, Callable[[bytes], None]], None]  # key, question, function that is given the answer
Deliver = Callable[[bytes], bool]  # takes the payload; false: it has no room yet
_Place = tuple[str, int]  # key, and number of the receiver


@dataclass
class _Fetch:
    """Payload that is being fetched, and the newer one of the same key that is fetched after it."""

    assembly: Assembly
    deliver: Deliver
    is_reply: bool
    following: tuple[Manifest, Deliver, bool] | None = None
    payload: bytes | None = None  # complete, waiting for room
    next_delivery_s: float = 0.0
    handed_over: bool = False  # while it is delivered: its receiver may ask for another one at once


class Fetcher:
    """Receiver of large payloads, with a thread of its own that asks, waits and asks again.

    One payload of a key is fetched at a time and finished, however fast newer ones are announced; then the newest one
    follows. Thus a slow link carries some versions in full, not many in part.

    Args:
        ask: function that asks the sender of a key for a piece, and passes on the answer if one comes.
        most_bytes: largest payload that is fetched; a larger one is ignored.
        clock: monotonic clock in seconds.
    """

    def __init__(self, ask: Ask, most_bytes: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._ask, self._most_bytes, self._clock = ask, most_bytes, clock
        self._fetches: dict[_Place, _Fetch] = {}
        self._delivered: dict[_Place, bytes] = {}  # digest of the last payload
        self._changed = threading.Condition()
        self._closed = False
        self._thread: threading.Thread | None = None

    def fetching(self, key: str, receiver: int) -> bool:
        """Return whether a payload of a key is on its way to a receiver that has not got it yet."""
        with self._changed:
            fetch = self._fetches.get((key, receiver))
            return fetch is not None and not fetch.handed_over

    def fetch(self, key: str, receiver: int, manifest: Manifest, deliver: Deliver, *, is_reply: bool = True) -> None:
        """Fetch a payload.

        Args:
            key: key of the payload.
            receiver: number that tells receivers of the same key apart.
            manifest: manifest that the sender announced.
            deliver: function that takes the payload, on another thread; it is called again until it returns true.
            is_reply: whether the payload has one receiver, whose sender is told when it has everything, and which gets
                it even if the last one delivered was the same.
        """
        place = (key, receiver)
        with self._changed:
            if self._closed or not 0 < manifest.size <= self._most_bytes:
                return
            fetch = self._fetches.get(place)
            if fetch is not None:
                if (is_reply and fetch.handed_over) or fetch.assembly.manifest != manifest:
                    fetch.following = (manifest, deliver, is_reply)
            elif is_reply or self._delivered.get(place) != manifest.digest:
                self._begin(place, manifest, deliver, is_reply)

    def close(self) -> None:
        """Stop; nothing is delivered afterwards."""
        with self._changed:
            self._closed = True
            self._fetches.clear()
            self._changed.notify()

    def _begin(self, place: _Place, manifest: Manifest, deliver: Deliver, is_reply: bool) -> None:
        self._fetches[place] = _Fetch(Assembly(manifest, self._clock()), deliver, is_reply)
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="fetcher", daemon=True)
            self._thread.start()
        self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                if self._closed:
                    return
                now = self._clock()
                questions = [
                    (place, fetch, index)
                    for place, fetch in self._fetches.items()
                    if fetch.payload is None and not fetch.assembly.complete
                    for index in fetch.assembly.due(now)
                ]
                ended = [(place, fetch) for place, fetch in self._fetches.items() if _is_due(fetch, now)]
                if not questions and not ended:
                    wake_s = min(map(_wake_s, self._fetches.values()), default=None)
                    self._changed.wait(None if wake_s is None else max(0.0, wake_s - now))
                    continue
            for (key, _), fetch, index in questions:
                question = _QUESTION.pack(fetch.assembly.manifest.digest, index)
                self._ask(key, question, self._adder(fetch.assembly, index))
            for place, fetch in ended:
                self._end(place, fetch)

    def _adder(self, assembly: Assembly, index: int) -> Callable[[bytes], None]:
        def add(piece: bytes) -> None:
            with self._changed:
                assembly.add(index, piece, self._clock())
                self._changed.notify()

        return add

    def _end(self, place: _Place, fetch: _Fetch) -> None:
        """Deliver a complete payload or give up; then begin with the newest one that was announced meanwhile."""
        digest = fetch.assembly.manifest.digest
        if fetch.assembly.complete:
            if fetch.payload is None:
                fetch.payload = fetch.assembly.payload()
                if fetch.payload is not None and fetch.is_reply:
                    self._ask(place[0], _QUESTION.pack(digest, _EVERYTHING), lambda _: None)
            if fetch.payload is not None:
                fetch.handed_over = True
                if not fetch.deliver(fetch.payload):
                    fetch.handed_over = False
                    fetch.next_delivery_s = self._clock() + DELIVER_AGAIN_S
                    return
        with self._changed:
            if self._closed:
                return
            del self._fetches[place]
            if fetch.payload is not None:
                self._delivered[place] = digest
            if fetch.following is not None:
                self._begin(place, *fetch.following)


def _is_due(fetch: _Fetch, now: float) -> bool:
    """Return whether a fetch can be delivered, or has to be given up."""
    if fetch.payload is not None:
        return now >= fetch.next_delivery_s
    return fetch.assembly.complete or fetch.assembly.stalled(now)


def _wake_s(fetch: _Fetch) -> float:
    return fetch.next_delivery_s if fetch.payload is not None else fetch.assembly.next_wake_s


def _digest(payload: bytes) -> bytes:
    return hashlib.sha256(payload).digest()[:8]
