"""What every role shares: an identity, mailboxes that wake it, statistics twice a second, a liveliness token."""

import json
import os
import socket
import threading
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from zsdist.config import Config
from zsdist.errors import DecodeError
from zsdist.roles import schemas
from zsdist.roles.schemas import Content
from zsdist.transport.base import Mailbox, Message, Transport
from zsdist.wire import addresses, codec, keys
from zsdist.wire.messages import AnyMessage, Jobs, Orders, Records

Some = TypeVar("Some", bound=AnyMessage)
Checked = TypeVar("Checked")

STATISTICS_EVERY_S = 0.5  # the key space promises once a second; a step may take a while
HEARTBEAT_S = 0.25  # absolute states (orders, jobs) are said again this often


@dataclass(frozen=True)
class Context:
    """Who a role is and what it speaks through.

    Attributes:
        config: the whole run's configuration.
        run: the run's name on the key space.
        role: kind of role; `id`: which one of them.
        epoch: never used twice in a run directory; newer epochs overrule older ones.
        transport: carries bytes.
        wake: set whenever a mailbox of this role receives something.
    """

    config: Config
    run: str
    role: str
    id: str
    epoch: int
    transport: Transport
    wake: threading.Event = field(default_factory=threading.Event)

    @property
    def name(self) -> str:
        """The role's name in leases and logs, such as `actor-0`."""
        return f"{self.role}-{self.id}"


class Role(ABC):
    """A single-threaded object that owns its state. Subclasses implement `work` and `statistics`."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.config = context.config
        self.transport = context.transport
        self.finished = False  # set by `work` when nothing is left to do
        self._mailboxes: dict[str, Mailbox] = {}
        self._refused: Counter[str] = Counter()
        self._orders_epoch = -1  # of whoever gave orders last; older ones are stale
        self._next_statistics_s = 0.0
        self.transport.declare_alive(keys.alive(context.run, context.role, context.id))

    def step(self, now: float) -> float | None:
        """Does what is due at `now` (unix seconds) and returns when to call again; None once the role has finished."""
        if self.finished:
            return None
        wake_s = self.work(now)
        if now >= self._next_statistics_s or self.finished:
            self._next_statistics_s = now + STATISTICS_EVERY_S
            self._publish_statistics(now)
        return None if self.finished else min(wake_s, self._next_statistics_s)

    @abstractmethod
    def work(self, now: float) -> float:
        """One round of this role's work; returns when it wants to be called again at the latest."""

    @abstractmethod
    def statistics(self) -> dict[str, float | str]:
        """Flat numbers (and few words) with units in their names, published twice a second."""

    def mailbox(self, name: str) -> Mailbox:
        """A bounded mailbox that wakes this role."""
        box = Mailbox(self.config.transport.mailbox_bytes, self.context.wake.set)
        self._mailboxes[name] = box
        return box

    def messages(self, box: Mailbox, *expected: type[Some]) -> Iterator[tuple[Message, Some]]:
        """Drains `box`, decoded; what is none of the kinds expected, or not under its own key, is refused."""
        for message in box.drain():
            try:
                decoded = codec.decode(message.payload, expect=expected)
                addresses.require(message.key, self.context.run, decoded)
            except DecodeError as error:
                self.refuse(error.reason)
            else:
                yield message, decoded

    def orders(self, box: Mailbox, models: Mapping[type[Orders | Jobs], type[Content]]) -> Iterator[Content]:
        """Drains `box` of orders of its scheduler, or for the scheduler of its runner, read by their models."""
        for _, orders in self.messages(box, *models, Records):
            if isinstance(orders, Records):
                continue  # an actor's own, under the key that its jobs come by
            if orders.sender_epoch < self._orders_epoch:
                self.refuse("stale")
            elif (content := self.checked(schemas.read, models[type(orders)], orders.content)) is not None:
                self._orders_epoch = orders.sender_epoch
                yield content

    def checked(self, check: Callable[..., Checked], *arguments: Any) -> Checked | None:
        """What `check` makes of its arguments; None, and counted, where it raises `DecodeError`."""
        try:
            return check(*arguments)
        except DecodeError as error:
            self.refuse(error.reason)
            return None

    def refuse(self, reason: str) -> None:
        """Counts a message that is not acted on, as `rejected_{reason}` in the statistics."""
        self._refused[reason] += 1

    def event(self, now: float, event: str, **fields: float | str) -> None:
        """Publishes something worth telling a watcher."""
        self._publish_json(keys.events(self.context.run), now, {"event": event, **fields})

    def _publish_statistics(self, now: float) -> None:
        counts = {f"rejected_{reason}": count for reason, count in self._refused.items()}
        dropped = {f"mailbox_{name}_dropped": box.dropped for name, box in self._mailboxes.items() if box.dropped}
        context = self.context
        key = keys.stats(context.run, context.role, context.id)
        self._publish_json(key, now, {"epoch": context.epoch, **self.statistics(), **counts, **dropped})

    def _publish_json(self, key: str, now: float, fields: dict[str, float | str]) -> None:
        context = self.context
        about = {"time_s": round(now, 3), "role": context.role, "id": context.id, "host": HOST, "pid": os.getpid()}
        self.transport.publish(key, json.dumps({**about, **fields}, allow_nan=False).encode(), json=True)


HOST = socket.gethostname()
