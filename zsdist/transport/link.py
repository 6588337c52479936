"""Open session of zenoh with what its callbacks need: retained values, and payloads that travel in pieces."""

import contextlib
import ctypes
import os
import threading
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import zenoh
import zenoh.handlers

from zsdist.errors import TransportError
from zsdist.transport.base import Mailbox, Message
from zsdist.transport.pieces import LOST_AFTER_MAX_S, Fetcher, Manifest, PieceStore
from zsdist.transport.session_config import brief

WHOLE_RETAINED_BYTES = 256 * 1024  # largest retained value that is sent whole
WHOLE_REPLY_BYTES = 2**20  # largest reply that is sent whole; more than a learner's usual batches
MAX_FETCHED_BYTES = 4 * 2**30
STAMP_IDENTITY = 8  # bytes
STAMP = STAMP_IDENTITY + 8
DROP = zenoh.CongestionControl.DROP


class Link:
    """Open session, and what its callbacks need. They do not refer to the transport, so that it can be dropped."""

    def __init__(self, endpoint: str, session: zenoh.Session) -> None:
        self.session = session
        self.retained: dict[str, Retained] = {}
        self.entities: list[Any] = []  # subscribers, services and tokens, which live as long as they are referred to
        self.open = threading.Event()
        self.open.set()
        self.values, self.replies = PieceStore(release=False), PieceStore(release=True)
        self.fetcher = Fetcher(self._ask, MAX_FETCHED_BYTES)
        self._endpoint = endpoint
        _links.add(self)

    def close(self) -> None:
        """Close the session; nothing arrives afterwards."""
        self.open.clear()
        self.fetcher.close()
        self.entities.clear()
        self.retained.clear()
        self.session.close()  # type: ignore[no-untyped-call]  # zenoh declares no return type

    def put(self, mailbox: Mailbox, message: Message) -> bool:
        """Put a message into a mailbox; return false if it had no room."""
        return not self.open.is_set() or mailbox.append(message)

    def receive(
        self, mailbox: Mailbox, key: str, content: zenoh.ZBytes, manifest: Manifest | None, *, is_reply: bool
    ) -> None:
        """Put what was sent whole into a mailbox, and fetch what was announced by a manifest."""
        if manifest is None:
            self.put(mailbox, Message(key, content.to_bytes()))
            return

        def deliver(payload: bytes) -> bool:
            return self.put(mailbox, Message(key, payload))

        self.fetcher.fetch(key, id(mailbox), manifest, deliver, is_reply=is_reply)

    def retain(self, key: str, payload: bytes, identity: bytes, encoding: zenoh.Encoding) -> "Retained | None":
        """Keep the newest value of a key.

        Returns:
            What to send; None, and the value is dropped like any other message, while receivers still fetch several
            earlier ones.
        """
        before = self.retained.get(key)
        number = 1 if before is None else before.number + 1
        stamp = identity + number.to_bytes(8, "big")
        if len(payload) > WHOLE_RETAINED_BYTES:
            manifest = self.values.keep(key, payload)
            if manifest is None:
                return None
            payload, stamp = b"", stamp + manifest.pack()
        self.retained[key] = Retained(number, stamp, payload, encoding)
        return self.retained[key]

    def once(self, query: zenoh.Query) -> Callable[[bytes], None]:
        """Return a function that replies to a query at its first call."""
        waiting = [query]

        def reply(payload: bytes) -> None:
            if not waiting:
                return
            with waiting.pop() as open_query:  # closing the query tells the client that no further reply follows
                key, about = str(open_query.key_expr), None
                if len(payload) > WHOLE_REPLY_BYTES:
                    manifest = self.replies.keep(key, payload)
                    if manifest is None:
                        return  # earlier replies are still being fetched
                    payload, about = b"", manifest.pack()
                self.attempt(lambda: open_query.reply(open_query.key_expr, payload, attachment=about), key)

        return reply

    def answer_piece(self, query: zenoh.Query, store: PieceStore) -> None:
        """Answer a query that asks for a piece of a payload."""
        with query:
            assert query.attachment is not None, "the question is an attachment"
            piece = store.answer(str(query.key_expr), query.attachment.to_bytes())
            if piece is not None:
                query.reply(query.key_expr, piece)

    def _ask(self, key: str, question: bytes, answered: Callable[[bytes], None]) -> None:
        """Ask the sender of a payload for a piece; a question or an answer that is lost is asked again."""

        def replied(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                answered(reply.ok.payload.to_bytes())

        if self.open.is_set():
            with contextlib.suppress(zenoh.ZError):
                self.session.get(
                    key,
                    direct(replied),
                    attachment=question,
                    timeout=LOST_AFTER_MAX_S,
                    consolidation=zenoh.ConsolidationMode.NONE,
                    congestion_control=DROP,
                )

    def reply_retained(self, query: zenoh.Query) -> None:
        """Answer a query for the last value of a key, or for a piece of it."""
        if query.attachment is not None:
            self.answer_piece(query, self.values)
            return
        kept = self.retained.get(str(query.key_expr))
        if kept is not None:
            query.reply(query.key_expr, kept.payload, encoding=kept.encoding, attachment=kept.stamp)

    def attempt(self, action: Callable[[], Any], key: str) -> Any:
        """Return the result of an action; raise `TransportError` where zenoh refuses it or the session is closed."""
        if not self.open.is_set():
            raise TransportError(f"transport to {self._endpoint} is closed; {key} cannot be used")
        try:
            return action()
        except zenoh.ZError as error:
            raise TransportError(f"{key} at {self._endpoint}: {brief(error)}") from error


_links: weakref.WeakSet[Link] = weakref.WeakSet()


def _abandon() -> None:
    """Keep all sessions for ever, in a forked process: their threads are missing, and closing would wait for them."""
    for link in _links:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(link))


os.register_at_fork(after_in_child=_abandon)


@dataclass(frozen=True)
class Retained:
    """Last value of a key, and the stamp by which receivers recognise it: identity of the sender, then number.

    A value that is fetched in pieces has an empty payload here, and its manifest after the stamp.
    """

    number: int
    stamp: bytes
    payload: bytes
    encoding: zenoh.Encoding


class Newest:
    """Filter that tells new retained values from known ones; zenoh's threads share it."""

    def __init__(self) -> None:
        self._stamps: dict[str, bytes] = {}
        self._lock = threading.Lock()

    def is_new(self, key: str, stamp: bytes) -> bool:
        """Return whether a value is newer than the last one of its sender; a value of another sender is always new."""
        with self._lock:
            last = self._stamps.get(key, b"")
            if last[:STAMP_IDENTITY] == stamp[:STAMP_IDENTITY] and stamp <= last:
                return False
            self._stamps[key] = stamp
            return True


def direct(callback: Callable[[Any], None]) -> "zenoh.handlers.Callback[Any]":
    """Return a handler that is called on zenoh's own thread; `callback` may only fill a mailbox.

    By default, each callback has an unbounded queue and a Python thread that keeps the process from ending.
    """
    return zenoh.handlers.Callback(callback, indirect=False)
