"""Interface of transports, and the mailboxes that they fill.

A pattern is a key expression: `*` matches one part of a key, `**` any number of parts.
"""

import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from zsdist.common.ownership import Owned


@dataclass(frozen=True)
class Message:
    """Bytes received under a key. Only a request has a `reply`, and only its first call has an effect."""

    key: str
    payload: bytes
    reply: Callable[[bytes], None] | None = None


class Mailbox(Owned):
    """Queue in which the threads of a transport put messages for a role.

    Appending never blocks. A message that does not fit into the byte budget is dropped and counted, since the protocol
    sends it again. Messages that were drained last count until the next time: they are being processed, and still take
    memory. An empty mailbox accepts any message, so that none is too large forever.

    Attributes:
        dropped: number of messages that did not fit.
        peak_bytes: greatest number of bytes that have waited at once.
    """

    def __init__(self, max_bytes: int, wake: Callable[[], None] | None = None) -> None:
        """Make an empty mailbox.

        Args:
            max_bytes: most bytes of keys and payloads that may wait or be in process.
            wake: function that is called after each message, on the thread of the sender.
        """
        self.dropped = 0
        self.peak_bytes = 0
        self._max_bytes = max_bytes
        self._wake = wake
        self._bytes = 0
        self._drained_bytes = 0
        self._messages: deque[Message] = deque()
        self._lock = threading.Lock()

    def append(self, message: Message) -> bool:
        """Add a message; return false if it was dropped."""
        size = len(message.key) + len(message.payload)
        with self._lock:
            if self._messages and self._bytes + self._drained_bytes + size > self._max_bytes:
                self.dropped += 1
                return False
            self._messages.append(message)
            self._bytes += size
            self.peak_bytes = max(self.peak_bytes, self._bytes)
        if self._wake is not None:
            self._wake()
        return True

    def drain(self) -> list[Message]:
        """Remove and return all messages, oldest first."""
        with self._lock:
            messages = list(self._messages)
            self._messages.clear()
            self._bytes, self._drained_bytes = 0, self._bytes
        return messages

    def __len__(self) -> int:
        return len(self._messages)


class Transport(Owned, ABC):
    """Best-effort transport of bytes between roles; the protocol above it repeats messages that must not be lost.

    A transport that is dropped is closed.
    """

    @abstractmethod
    def publish(self, key: str, payload: bytes, *, retained: bool = False, json: bool = False) -> None:
        """Send a message to all subscribers, never waiting for one: if a queue is full, the message is dropped.

        Args:
            key: key of the message.
            payload: content of the message; it is copied.
            retained: whether later subscribers get the last value of this key too, as long as this transport is open.
            json: whether the payload is JSON text, which is labelled as such for other programs.
        """

    @abstractmethod
    def subscribe(self, pattern: str, mailbox: Mailbox, *, retained: bool = False) -> None:
        """Put matching messages into `mailbox`; with `retained`, first the last retained value of each key, once."""

    @abstractmethod
    def serve(self, pattern: str, mailbox: Mailbox) -> None:
        """Put matching requests into `mailbox`, as messages with a `reply`."""

    @abstractmethod
    def request(self, key: str, payload: bytes, mailbox: Mailbox, *, timeout_s: float) -> None:
        """Send a request to the server of `key`. Its reply goes into `mailbox`; if none comes, request again."""

    @abstractmethod
    def declare_alive(self, key: str) -> None:
        """Hold a liveliness token at `key` until this transport closes or its process dies."""

    @abstractmethod
    def watch_alive(self, pattern: str, mailbox: Mailbox) -> None:
        """Put `b"1"` into `mailbox` for each matching token that exists or appears, `b"0"` for each that disappears."""

    @abstractmethod
    def close(self) -> None:
        """Release everything. Nothing arrives afterwards, and a second call does nothing."""
