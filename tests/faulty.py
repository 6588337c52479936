"""Transport that loses, repeats, delays and reorders messages reproducibly, for tests of everything above it."""

import heapq
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

import numpy as np

from zsdist.transport.base import Mailbox, Transport


@dataclass(frozen=True)
class Faults:
    """Faults of publications and requests, as shares of messages.

    Attributes:
        drop: share that is lost.
        repeat: share that arrives twice.
        delay: share that arrives late, so that later messages overtake it.
        delay_s: longest delay.
        reorder: share that is swapped with the next message.
    """

    drop: float = 0.0
    repeat: float = 0.0
    delay: float = 0.0
    delay_s: float = 0.1
    reorder: float = 0.0


class FaultyTransport(Transport):
    """Transport around another one; delayed messages are sent by `tick`, and no clock is read.

    Attributes:
        faults: faults to cause; may be replaced at any time, and `Faults()` ends all faults.
    """

    def __init__(self, inner: Transport, seed: int, faults: Faults | None = None) -> None:
        """Wrap `inner`; equal seeds and equal calls give equal faults."""
        self.faults = Faults() if faults is None else faults
        self._inner = inner
        self._rng = np.random.default_rng(seed)
        self._now = 0.0
        self._late: list[tuple[float, int, Callable[[], None]]] = []
        self._swapped: list[Callable[[], None]] = []
        self._order = count()

    def tick(self, now: float) -> None:
        """Set the time; send messages that were delayed until `now`, and the one that waits to be swapped."""
        self._now = now
        self._release_swapped()
        while self._late and self._late[0][0] <= now:
            heapq.heappop(self._late)[2]()

    def publish(self, key: str, payload: bytes, *, retained: bool = False, json: bool = False) -> None:
        """See `Transport.publish`; all faults occur."""
        payload = bytes(payload)
        self._send(lambda: self._inner.publish(key, payload, retained=retained, json=json))

    def request(self, key: str, payload: bytes, mailbox: Mailbox, *, timeout_s: float) -> None:
        """See `Transport.request`; all faults occur for the request, none for the reply."""
        payload = bytes(payload)
        self._send(lambda: self._inner.request(key, payload, mailbox, timeout_s=timeout_s))

    def subscribe(self, pattern: str, mailbox: Mailbox, *, retained: bool = False) -> None:
        """See `Transport.subscribe`."""
        self._inner.subscribe(pattern, mailbox, retained=retained)

    def serve(self, pattern: str, mailbox: Mailbox) -> None:
        """See `Transport.serve`."""
        self._inner.serve(pattern, mailbox)

    def declare_alive(self, key: str) -> None:
        """See `Transport.declare_alive`."""
        self._inner.declare_alive(key)

    def watch_alive(self, pattern: str, mailbox: Mailbox) -> None:
        """See `Transport.watch_alive`."""
        self._inner.watch_alive(pattern, mailbox)

    def close(self) -> None:
        """See `Transport.close`; delayed messages are lost."""
        self._late.clear()
        self._swapped.clear()
        self._inner.close()

    def _send(self, send: Callable[[], None]) -> None:
        dropped, repeated, delayed, swapped = self._rng.random(4) < (
            self.faults.drop,
            self.faults.repeat,
            self.faults.delay,
            self.faults.reorder,
        )
        if dropped:
            return
        if repeated:
            self._dispatch(send, delayed=self._rng.random() < self.faults.delay, swapped=False)
        self._dispatch(send, delayed=delayed, swapped=swapped)

    def _dispatch(self, send: Callable[[], None], *, delayed: bool, swapped: bool) -> None:
        if delayed:
            heapq.heappush(self._late, (self._now + self.faults.delay_s * self._rng.random(), next(self._order), send))
        elif swapped and not self._swapped:
            self._swapped.append(send)
        else:
            send()
            self._release_swapped()

    def _release_swapped(self) -> None:
        while self._swapped:
            self._swapped.pop()()
