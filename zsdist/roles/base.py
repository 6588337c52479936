"""What every role shares: an identity, mailboxes that wake it, statistics twice a second, a liveliness token."""

import json
import os
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field

from zsdist.config import Config
from zsdist.errors import DecodeError
from zsdist.transport.base import Mailbox, Message, Transport
from zsdist.wire import codec, keys
from zsdist.wire.messages import AnyMessage

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
        self._undecodable: dict[str, int] = {}
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

    def messages(self, box: Mailbox) -> Iterator[tuple[Message, AnyMessage]]:
        """Drains `box`, decoded; what cannot be decoded is counted by reason and dropped."""
        for message in box.drain():
            try:
                yield message, codec.decode(message.payload)
            except DecodeError as error:
                self._undecodable[error.reason] = self._undecodable.get(error.reason, 0) + 1

    def event(self, now: float, event: str, **fields: float | str) -> None:
        """Publishes something worth telling a watcher."""
        self._publish_json(keys.events(self.context.run), now, {"event": event, **fields})

    def _publish_statistics(self, now: float) -> None:
        counts = {f"rejected_{reason}": count for reason, count in self._undecodable.items()}
        dropped = {f"mailbox_{name}_dropped": box.dropped for name, box in self._mailboxes.items() if box.dropped}
        context = self.context
        key = keys.stats(context.run, context.role, context.id)
        self._publish_json(key, now, {"epoch": context.epoch, **self.statistics(), **counts, **dropped})

    def _publish_json(self, key: str, now: float, fields: dict[str, float | str]) -> None:
        context = self.context
        about = {"time_s": round(now, 3), "role": context.role, "id": context.id, "host": HOST, "pid": os.getpid()}
        self.transport.publish(key, json.dumps({**about, **fields}, allow_nan=False).encode(), json=True)


HOST = socket.gethostname()
