"""Mailboxes that a test can wait for, and free ports, for tests with real sockets."""

import socket
import threading
import time
from collections.abc import Callable

from zsdist.transport.base import Mailbox, Message

PATIENCE_S = 10.0


class Inbox(Mailbox):
    """Mailbox that a test can wait for without sleeping."""

    def __init__(self, max_bytes: int = 64 * 2**20) -> None:
        self.woken = threading.Event()
        self.seen: list[Message] = []
        super().__init__(max_bytes, self.woken.set)

    def wait(self, count: int = 1, timeout_s: float = PATIENCE_S) -> list[Message]:
        """Return all messages once there are `count`, or when the time is over."""
        return self.wait_for(lambda seen: len(seen) >= count, timeout_s)

    def wait_for(self, condition: Callable[[list[Message]], bool], timeout_s: float = PATIENCE_S) -> list[Message]:
        """Return all messages once a condition holds for them, or when the time is over."""
        end = time.monotonic() + timeout_s
        while not condition(self.seen) and self.woken.wait(max(0.0, end - time.monotonic())):
            self.woken.clear()
            self.seen += self.drain()
        return self.seen


def free_endpoint(protocol: str = "tcp") -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"{protocol}/127.0.0.1:{probe.getsockname()[1]}"
