"""A transport that does badly on purpose, repeatably: for tests of everything above it."""

import heapq
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

import numpy as np

from zsdist.transport.base import Mailbox, Transport


@dataclass(frozen=True)
class Faults:
    """What goes wrong with what is published or asked for; shares are of messages.

    Attributes:
        drop: share that vanishes.
        repeat: share that arrives twice.
        delay: share that arrives late, by up to `delay_s`, so that later ones overtake it.
        delay_s: the most that a late message is late by.
        reorder: share that changes places with the next message sent.
    """

    drop: float = 0.0
    repeat: float = 0.0
    delay: float = 0.0
    delay_s: float = 0.1
    reorder: float = 0.0


class FaultyTransport(Transport):
    """Wraps a transport. What is delayed goes out in `tick`, which tells it the time; it reads no clock.

    Attributes:
        faults: may be replaced while in use, by `Faults()` to end the trouble.
    """

    def __init__(self, inner: Transport, seed: int, faults: Faults | None = None) -> None:
        """Wraps `inner`; equal seeds and equal calls give equal faults."""
        self.faults = Faults() if faults is None else faults
        self._inner = inner
        self._rng = np.random.default_rng(seed)
        self._now = 0.0
        self._late: list[tuple[float, int, Callable[[], None]]] = []
        self._swapped: list[Callable[[], None]] = []
        self._order = count()

    def tick(self, now: float) -> None:
        """Lets time pass: sends what was delayed until `now`, and whatever still waits to change places."""
        self._now = now
        self._release_swapped()
        while self._late and self._late[0][0] <= now:
            heapq.heappop(self._late)[2]()

    def publish(self, key: str, payload: bytes, *, retained: bool = False, json: bool = False) -> None:
        """See `Transport.publish`; suffers all faults."""
        payload = bytes(payload)
        self._send(lambda: self._inner.publish(key, payload, retained=retained, json=json))

    def request(self, key: str, payload: bytes, mailbox: Mailbox, *, timeout_s: float) -> None:
        """See `Transport.request`; the question suffers all faults, its answer none."""
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
        """See `Transport.close`; what was delayed is lost."""
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
