"""Sight of a run by those who join it from elsewhere, with the rights of an actor."""

import time

from zsdist.errors import DecodeError, RunError
from zsdist.roles import schemas
from zsdist.roles.schemas import ActorOrders
from zsdist.transport.base import Mailbox, Transport
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders

FIND_WITHIN_S = 5.0


class OrdersWatch:
    """A run as its actors see it: whether it is there, ends, and how far it is.

    Attributes:
        runs: names of all runs whose scheduler is at the hub.
        closing: whether the run's newest orders say that it ends.
        finished: number of its finished episodes.
    """

    def __init__(self, transport: Transport) -> None:
        self.runs: set[str] = set()
        self.closing = False
        self.finished = 0
        self._transport = transport
        self._heard_s = time.monotonic()
        self._orders_epoch = -1
        self._tokens, self._orders = Mailbox(2**20), Mailbox(4 * 2**20)
        transport.watch_alive(keys.alive(keys.ANY, "scheduler", keys.ANY), self._tokens)

    @property
    def silent_s(self) -> float:
        """Seconds since the last orders of the run."""
        return time.monotonic() - self._heard_s

    def find(self, endpoint: str) -> str:
        """Return the name of the only run at the hub, and follow it.

        Raises:
            RunError: there is none, or several.
        """
        end_s = time.monotonic() + FIND_WITHIN_S
        while not self.runs and time.monotonic() < end_s:
            time.sleep(0.1)
            self.update()
        if len(self.runs) != 1:
            found = ", ".join(sorted(self.runs)) or "none"
            raise RunError(f"runs at {endpoint}: {found}; allowed is exactly one to join")
        (run,) = self.runs
        self._transport.subscribe(keys.control(run, "actor"), self._orders, retained=True)
        return run

    def update(self) -> None:
        """Receive what has arrived."""
        for message in self._tokens.drain():
            if (parsed := keys.parse(message.key)) is not None:
                (self.runs.add if message.payload == b"1" else self.runs.discard)(parsed.run)
        for message in self._orders.drain():
            try:
                orders = codec.decode(message.payload, expect=Orders)
                content = schemas.read(ActorOrders, orders.content)
            except DecodeError:
                continue  # each actor counts it
            if orders.sender_epoch >= self._orders_epoch:
                self._orders_epoch, self._heard_s = orders.sender_epoch, time.monotonic()
                self.closing, self.finished = content.closing, content.finished
