"""Receiving half of the push protocol: order, duplicates, acknowledgements and counts. It uses no socket and no clock.

Frames of epochs that were not issued are refused. A newer epoch of an actor abandons the older one at its last frame
without a gap, so the counts agree even if the actor has died.
"""

import heapq
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from zsdist.protocol.frames import Frame
from zsdist.types import MAX_REASON, Ack, Level

HOLD_FRAMES = 256  # number of frames, from the next expected one on, that are held; later ones are refused
MOST_LOST = 2**24  # most frames, and most transitions or records in them, that are skipped at once
HOLD_BYTES = 8 * 2**20  # most bytes that these frames may take in memory; a usual frame has some ten thousand
ACK_EVERY_FRAMES = 8
ACK_AFTER_S = 0.02
HEARTBEAT_S = 0.25

AnyFrame = TypeVar("AnyFrame", bound=Frame)


@dataclass
class _Stream(Generic[AnyFrame]):
    """State of the current epoch of an actor.

    Attributes:
        epoch: number of the epoch.
        received: number of frames delivered, which is the sequence number of the next expected frame.
        produced: running total at the last delivered frame.
        declared: highest running total in any frame received.
        granted: highest credit announced; None while it is unlimited.
        state: "open", "closed" by its last frame, or "abandoned".
        held: frames that arrived out of order, by sequence number.
        unacknowledged: number of frames received since the last acknowledgement.
        receipt_s: time of the first frame since the last acknowledgement.
        heartbeat_s: time of the next heartbeat; None: at once.
        refusal: why a frame of the epoch was refused since the last one was delivered; empty: none was.
        queued_s: time of the stream's entry in the queue of acknowledgements; it is not later than the due one.
    """

    epoch: int
    received: int = 0
    produced: int = 0
    declared: int = 0
    granted: int | None = 0
    state: str = "open"
    held: dict[int, AnyFrame] = field(default_factory=dict)
    unacknowledged: int = 0
    receipt_s: float | None = None
    heartbeat_s: float | None = None
    refusal: str = ""
    queued_s: float = float("inf")


class Inbox(Generic[AnyFrame]):
    """Receiver of the frames of one stream from any number of actors; a call takes no longer where there are many.

    Attributes:
        stream: `Level` or name of the stream.
        sender_epoch: incarnation of the receiving role, for its acknowledgements.
        duplicates: number of frames that arrived again.
        refused: number of refused frames by reason.
        abandoned_at_most: upper bound of the transitions (or records) that were produced in abandoned epochs and never
            delivered: granted minus delivered.
        abandoned_unlimited: number of epochs that were abandoned while their credit was unlimited. For these,
            `abandoned_at_most` includes only the totals that their frames declared.
    """

    def __init__(
        self,
        stream: Level | str,
        *,
        sender_epoch: int = 0,
        hold_frames: int = HOLD_FRAMES,
        hold_bytes: int = HOLD_BYTES,
    ) -> None:
        """Make an inbox that refuses all frames until an epoch is issued.

        Args:
            stream: `Level` or name of the stream.
            sender_epoch: incarnation of the receiving role.
            hold_frames: number of frames, from the next expected one on, that are held until those before them arrive.
            hold_bytes: most bytes of these frames of one actor.
        """
        self.stream = stream
        self.sender_epoch = sender_epoch
        self.duplicates = 0
        self.refused: Counter[str] = Counter()
        self.abandoned_at_most = 0
        self.abandoned_unlimited = 0
        self._hold_frames, self._hold_bytes = hold_frames, hold_bytes
        self._streams: dict[str, _Stream[AnyFrame]] = {}
        self._produced_before = 0  # in epochs no longer current
        self._open = 0  # streams that are open
        self._places: dict[str, int] = {}  # of the actors, in the order of their first epochs
        self._queue: list[tuple[float, int, str]] = []  # heap of times of acknowledgements, with place and actor

    @property
    def produced(self) -> int:
        """Number of transitions (or records) delivered, over all epochs."""
        return self._produced_before + sum(stream.produced for stream in self._streams.values())

    @property
    def closed(self) -> bool:
        """True if every issued epoch is closed or abandoned."""
        return not self._open

    def open_streams(self) -> list[tuple[str, int]]:
        """Return the (actor, epoch) pairs that may still send."""
        return [(actor, stream.epoch) for actor, stream in self._streams.items() if stream.state == "open"]

    def issue(self, actor: str, epoch: int) -> None:
        """Accept an epoch from now on instead of the actor's older one; an epoch that is not newer is ignored."""
        current = self._streams.get(actor)
        if current is not None:
            if epoch <= current.epoch:
                return
            self._abandon(current)
            self._produced_before += current.produced
        self._places.setdefault(actor, len(self._places))
        self._streams[actor] = _Stream(epoch, granted=0 if isinstance(self.stream, Level) else None)
        self._open += 1
        self._enqueue(actor)

    def close(self, actor: str, epoch: int) -> None:
        """Abandon the current epoch of an actor that has died and is not replaced."""
        current = self._streams.get(actor)
        if current is not None and current.epoch == epoch:
            self._abandon(current)

    def receive(self, frame: AnyFrame, now: float) -> list[AnyFrame]:
        """Accept a frame and return the frames that can be delivered now, in order and each exactly once."""
        stream = self._streams.get(frame.actor)
        if frame.stream != self.stream:
            return self._refuse("wrong_stream")
        if stream is None or frame.epoch > stream.epoch:
            return self._refuse("unknown_epoch")
        if frame.epoch < stream.epoch or stream.state == "abandoned":
            return self._refuse("closed_epoch")
        if frame.sequence >= stream.received and stream.state == "closed":
            return self._refuse("after_close", stream)
        if frame.sequence >= stream.received + self._hold_frames:
            return self._refuse("beyond_window", stream)
        if frame.sequence > stream.received and not self._has_room(stream, frame):
            return self._refuse("no_room")  # it is sent again; the next one in order is always accepted
        stream.unacknowledged += 1
        stream.receipt_s = now if stream.receipt_s is None else stream.receipt_s
        self._enqueue(frame.actor)
        if frame.sequence < stream.received or frame.sequence in stream.held:
            self.duplicates += 1
            return []
        stream.held[frame.sequence] = frame
        return self._deliver(stream)

    def skip(self, actor: str, epoch: int, received: int, produced: int, *, closed: bool = False) -> int | None:
        """Go on behind frames that were acknowledged and are lost for good, and count their content as delivered.

        One of them that arrives after all is a duplicate. Nothing happens where none of them is missing, or where more
        are than `MOST_LOST`, which no honest sender claims.

        Args:
            actor: name of the actor.
            epoch: its epoch; only the current one, while it is open, has anything to skip.
            received: number of frames that were acknowledged.
            produced: running total at the last of them.
            closed: whether that one closed the epoch.

        Returns:
            The number of transitions (or records) in the lost frames; None if no frame is missing.
        """
        stream = self._streams.get(actor)
        if stream is None or stream.epoch != epoch or stream.state != "open":
            return None
        lost, frames = produced - stream.produced, received - stream.received
        if not (0 < frames <= MOST_LOST and 0 <= lost <= MOST_LOST):
            return None
        stream.received, stream.produced, stream.refusal = received, produced, ""
        stream.declared = max(stream.declared, produced)
        stream.held = {sequence: frame for sequence, frame in stream.held.items() if sequence >= received}
        if closed:
            self._end(stream, "closed")
        return lost

    def progress(self, actor: str) -> tuple[int, int, int, bool]:
        """Return an actor's epoch, the frames delivered of it, its running total, and whether it is closed."""
        stream = self._streams[actor]
        return stream.epoch, stream.received, stream.produced, stream.state == "closed"

    def _has_room(self, stream: _Stream[AnyFrame], frame: AnyFrame) -> bool:
        """Return whether a frame that arrives early may be held: nobody can fill the memory with such frames."""
        return sum(held.nbytes for held in stream.held.values()) + frame.nbytes <= self._hold_bytes

    def note_refusal(self, actor: str, epoch: int, reason: str) -> None:
        """Tell an actor, in its acknowledgements, why a frame of it was refused before it got here."""
        stream = self._streams.get(actor)
        if stream is not None and stream.epoch == epoch:
            stream.refusal = "".join(filter(str.isprintable, reason))[:MAX_REASON]

    def acks(self, now: float, credit: Callable[[str, int], int | None]) -> list[Ack]:
        """Return the acknowledgements that are due.

        They confirm all delivered frames, which are never sent again; so store the frames before this call.

        Args:
            now: current time in seconds.
            credit: function that returns the absolute total that an open (actor, epoch) may produce; None: unlimited.
        """
        acks = []
        for actor in self._take_due(now):
            stream = self._streams[actor]
            allowed = credit(actor, stream.epoch) if stream.state == "open" else stream.produced
            stream.granted = None if allowed is None else max(stream.granted or 0, allowed)
            name, refusal = str(self.stream), stream.refusal
            acks.append(Ack(self.sender_epoch, actor, stream.epoch, name, stream.received, allowed, refusal))
            stream.unacknowledged, stream.receipt_s, stream.heartbeat_s = 0, None, now + HEARTBEAT_S
            self._enqueue(actor)
        return acks

    def next_wake(self, now: float) -> float | None:
        """Return the time of the next acknowledgement if no frame arrives; None: there is none."""
        due_s = self._first_due_s()
        if due_s == _NEVER:
            return None
        return now if due_s == _AT_ONCE else due_s

    def state(self) -> dict[str, Any]:
        """Return the state for a checkpoint as plain data, without frames held out of order: they are sent again."""
        current = {actor: {name: getattr(stream, name) for name in _KEPT} for actor, stream in self._streams.items()}
        totals = {name: getattr(self, name) for name in _TOTALS}
        return {"stream": str(self.stream), "current": current, "refused": dict(self.refused), **totals}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        self._streams = {actor: _Stream(**kept) for actor, kept in state["current"].items()}
        self.refused = Counter(state["refused"])
        for name in _TOTALS:
            setattr(self, name, state[name])
        self._open = len(self.open_streams())
        self._places = {actor: place for place, actor in enumerate(self._streams)}
        self._queue = []
        for actor in self._streams:
            self._enqueue(actor)

    def _enqueue(self, actor: str) -> None:
        """Queue a stream for the time at which its acknowledgement is due, unless it is queued for an earlier one."""
        stream = self._streams[actor]
        due_s = _due(stream)
        if due_s < stream.queued_s:
            stream.queued_s = due_s
            heapq.heappush(self._queue, (due_s, self._places[actor], actor))

    def _first_due_s(self) -> float:
        """Return the time at which the next acknowledgement is due, that of the first entry of the queue."""
        while self._queue:
            time_s, _, actor = self._queue[0]
            stream = self._streams[actor]
            if time_s == stream.queued_s == _due(stream):
                return time_s
            heapq.heappop(self._queue)
            if time_s == stream.queued_s:  # else the stream has an earlier entry, or had one
                stream.queued_s = _NEVER
                self._enqueue(actor)
        return _NEVER

    def _take_due(self, now: float) -> list[str]:
        """Take the actors whose acknowledgements are due from the queue; return them in the order of their places."""
        due = []
        while self._first_due_s() <= now:
            _, place, actor = heapq.heappop(self._queue)
            self._streams[actor].queued_s = _NEVER
            due.append((place, actor))
        return [actor for _, actor in sorted(due)]

    def _deliver(self, stream: _Stream[AnyFrame]) -> list[AnyFrame]:
        delivered = []
        while (frame := stream.held.pop(stream.received, None)) is not None:
            if frame.produced != stream.produced + frame.count:
                self._refuse("wrong_total", stream)  # a damaged frame; the right one is sent again
                break
            stream.received, stream.refusal = stream.received + 1, ""
            stream.produced = frame.produced
            delivered.append(frame)
            if frame.closes:
                self._end(stream, "closed")
                stream.held.clear()
        stream.declared = max([stream.declared, stream.produced, *(held.produced for held in stream.held.values())])
        return delivered

    def _abandon(self, stream: _Stream[AnyFrame]) -> None:
        if stream.state != "open":
            return
        self._end(stream, "abandoned")
        stream.held.clear()
        if stream.granted is None and isinstance(self.stream, Level):
            self.abandoned_unlimited += 1
        self.abandoned_at_most += max(stream.granted or 0, stream.declared) - stream.produced

    def _end(self, stream: _Stream[AnyFrame], state: str) -> None:
        """End an open stream."""
        stream.state = state
        self._open -= 1

    def _refuse(self, reason: str, stream: _Stream[AnyFrame] | None = None) -> list[AnyFrame]:
        self.refused[reason] += 1
        if stream is not None:
            stream.refusal = reason
        return []


_NEVER, _AT_ONCE = float("inf"), float("-inf")
_KEPT = ("epoch", "received", "produced", "declared", "granted", "state")
_TOTALS = ("duplicates", "abandoned_at_most", "abandoned_unlimited", "_produced_before")


def _due(stream: _Stream[Any]) -> float:
    """Return the time at which an acknowledgement of a stream is due."""
    if stream.unacknowledged >= ACK_EVERY_FRAMES:
        return _AT_ONCE
    receipt = _NEVER if stream.receipt_s is None else stream.receipt_s + ACK_AFTER_S
    if stream.state != "open":  # acknowledged again only if its last frames arrive again
        return _NEVER if stream.state == "abandoned" else receipt
    return min(receipt, _AT_ONCE if stream.heartbeat_s is None else stream.heartbeat_s)
