"""What every transport offers, and the mailboxes it fills.

Patterns are key expressions: `*` stands for one part of a key, `**` for any number of parts.
"""

import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Message:
    """Bytes that came in under a key; `reply` is there only for requests, and only its first call counts."""

    key: str
    payload: bytes
    reply: Callable[[bytes], None] | None = None


class Mailbox:
    """Where a transport's threads leave messages for a role.

    Appending never blocks: what does not fit in the byte budget is dropped and counted, since the protocol sends it
    again. An empty mailbox takes any one message, so that none is too large for ever.

    Attributes:
        dropped: messages that did not fit.
        peak_bytes: the most that has ever waited.
    """

    def __init__(self, max_bytes: int, wake: Callable[[], None] | None = None) -> None:
        """Holds at most `max_bytes` of keys and payloads; calls `wake` after each message, from the sender's thread."""
        self.dropped = 0
        self.peak_bytes = 0
        self._max_bytes = max_bytes
        self._wake = wake
        self._bytes = 0
        self._messages: deque[Message] = deque()
        self._lock = threading.Lock()

    def append(self, message: Message) -> bool:
        """Leaves a message; False where it was dropped."""
        size = len(message.key) + len(message.payload)
        with self._lock:
            if self._messages and self._bytes + size > self._max_bytes:
                self.dropped += 1
                return False
            self._messages.append(message)
            self._bytes += size
            self.peak_bytes = max(self.peak_bytes, self._bytes)
        if self._wake is not None:
            self._wake()
        return True

    def drain(self) -> list[Message]:
        """Takes all that has come, oldest first."""
        with self._lock:
            messages = list(self._messages)
            self._messages.clear()
            self._bytes = 0
        return messages

    def __len__(self) -> int:
        return len(self._messages)


class Transport(ABC):
    """Carries bytes between roles. Best effort: whatever must not be lost is sent again by the protocol above."""

    @abstractmethod
    def publish(self, key: str, payload: bytes, *, retained: bool = False, json: bool = False) -> None:
        """Sends to all who subscribed. Never waits for a receiver: where a pipe is full the message is dropped.

        Args:
            key: where to.
            payload: what; copied.
            retained: the last value of this key also goes to those who subscribe later, while this transport is open.
            json: the payload is JSON text, and is labelled so for receivers that are not ours.
        """

    @abstractmethod
    def subscribe(self, pattern: str, mailbox: Mailbox, *, retained: bool = False) -> None:
        """Has messages that match put into `mailbox`; with `retained`, each key's last retained value first, once."""

    @abstractmethod
    def serve(self, pattern: str, mailbox: Mailbox) -> None:
        """Has requests that match put into `mailbox`, as messages with a `reply`."""

    @abstractmethod
    def request(self, key: str, payload: bytes, mailbox: Mailbox, *, timeout_s: float) -> None:
        """Asks whoever serves `key`. The answer comes into `mailbox`; where there is none, nothing comes: ask again."""

    @abstractmethod
    def declare_alive(self, key: str) -> None:
        """Keeps a token at `key` until this transport closes or its process dies."""

    @abstractmethod
    def watch_alive(self, pattern: str, mailbox: Mailbox) -> None:
        """Has a message `b"1"` put into `mailbox` for each token that is or comes there, `b"0"` for each that goes."""

    @abstractmethod
    def close(self) -> None:
        """Lets go of everything; nothing arrives afterwards, and a second call does nothing."""
