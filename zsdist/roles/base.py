"""Base of all roles: an identity, mailboxes that wake the role, statistics twice a second, a liveliness token."""

import json
import math
import os
import socket
import threading
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, ParamSpec, TypeVar, overload

from zsdist.common.background import Background, at_once
from zsdist.config import Config
from zsdist.errors import DecodeError
from zsdist.protocol import inbox
from zsdist.roles import schemas
from zsdist.roles.schemas import Content, StateRequest
from zsdist.transport.base import Mailbox, Message, Transport
from zsdist.types import Level
from zsdist.wire import addresses, codec, keys
from zsdist.wire.messages import AnyMessage, Candidate, Jobs, Orders, Records, State, WeightsMessage

Kind = TypeVar("Kind", bound=AnyMessage)
OtherKind = TypeVar("OtherKind", bound=AnyMessage)
Model = TypeVar("Model", bound=Content)
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

STATISTICS_EVERY_S = 0.5  # the key space promises once a second; a step may take a while
HEARTBEAT_S = inbox.HEARTBEAT_S  # absolute states (orders, jobs) are repeated as often as acknowledgements
HOST = socket.gethostname()


@dataclass(frozen=True)
class Context:
    """Identity of a role, and the transport through which it communicates.

    Attributes:
        config: configuration of the whole run.
        run: name of the run on the key space.
        role: kind of role.
        id: number or name that tells roles of one kind apart.
        epoch: number of this incarnation, never used twice in a run directory; newer epochs overrule older ones.
        transport: transport of all messages of the role.
        wake: event that is set whenever a mailbox of this role receives something.
        background: place for work that would hold up a step, such as encoding a state.
        launch: epoch of the runner; all older epochs are of processes that are gone with another runner.
    """

    config: Config
    run: str
    role: str
    id: str
    epoch: int
    transport: Transport
    wake: threading.Event = field(default_factory=threading.Event)
    background: Background = at_once
    launch: int = 0

    @property
    def name(self) -> str:
        """Name of the role in leases and logs, such as `actor-0`."""
        return f"{self.role}-{self.id}"


class Role(ABC):
    """Single-threaded object that owns its state. Subclasses implement `work` and `statistics`."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.config = context.config
        self.transport = context.transport
        self.finished = False  # set by `work` when nothing is left to do
        self._mailboxes: dict[str, Mailbox] = {}
        self._refused: Counter[str] = Counter()
        self._underway: list[Future[Any]] = []  # in the background
        self._orders_epoch = -1  # epoch of the newest sender of orders; orders of older ones are stale
        self._sender_epochs: dict[str, int] = {}  # newest known epoch of each other sender
        self._next_statistics_s = 0.0
        self.transport.declare_alive(keys.alive(context.run, context.role, context.id))

    def step(self, now: float) -> float | None:
        """Do the work that is due at `now` (unix seconds).

        Returns:
            The latest time of the next call; None once the role has finished.
        """
        if self.finished:
            return None
        self._end_jobs()
        wake_s = self.work(now)
        if now >= self._next_statistics_s or self.finished:
            self._next_statistics_s = now + STATISTICS_EVERY_S
            self._publish_statistics(now)
        return None if self.finished else min(wake_s, self._next_statistics_s)

    @abstractmethod
    def work(self, now: float) -> float:
        """Do one round of this role's work, and return the latest time of the next one (unix seconds)."""

    @abstractmethod
    def statistics(self) -> dict[str, float | str]:
        """Return flat numbers (and few words) with units in their names; they are published twice a second."""

    def mailbox(self, name: str) -> Mailbox:
        """Return a new bounded mailbox that wakes this role."""
        box = Mailbox(self.config.transport.mailbox_bytes, self.context.wake.set)
        self._mailboxes[name] = box
        return box

    @overload
    def messages(
        self, box: Mailbox, kind: type[Kind], /, *, own: type[AnyMessage] | None = None
    ) -> Iterator[tuple[Message, Kind]]: ...

    @overload
    def messages(
        self, box: Mailbox, kind: type[Kind], other: type[OtherKind], /
    ) -> Iterator[tuple[Message, Kind | OtherKind]]: ...

    @overload
    def messages(
        self, box: Mailbox, /, *kinds: type[AnyMessage], own: type[AnyMessage] | None = None
    ) -> Iterator[tuple[Message, AnyMessage]]: ...

    def messages(
        self, box: Mailbox, /, *kinds: type[Any], own: type[AnyMessage] | None = None
    ) -> Iterator[tuple[Message, Any]]:
        """Drain `box` and yield each message with its decoded content.

        A message that is of none of the expected kinds, or came under a key that is not its own, is refused. One of
        the kind `own` is this role's, published under the key of what it receives, and is left out undecoded.
        """
        for message in box.drain():
            try:
                if own is not None and codec.type_of(message.payload) is own:
                    continue
                decoded = codec.decode(message.payload, expect=kinds)
                addresses.require(message.key, self.context.run, decoded)
            except DecodeError as error:
                self.refuse(error.reason)
                self.tell_sender(message.key, str(error))
            else:
                yield message, decoded

    def requests(self, box: Mailbox, kind: type[Kind]) -> Iterator[tuple[Callable[[bytes], None], Kind]]:
        """Drain `box` of a served key, and yield each request after the function that replies to it."""
        for message, request in self.messages(box, kind):
            if message.reply is not None:  # None for publications, which no served key receives
                yield message.reply, request

    @overload
    def orders(self, box: Mailbox, models: Mapping[type[Orders], type[Model]]) -> Iterator[Model]: ...

    @overload
    def orders(self, box: Mailbox, models: Mapping[type[Orders | Jobs], type[Content]]) -> Iterator[Content]: ...

    def orders(self, box: Mailbox, models: Mapping[Any, type[Content]]) -> Iterator[Content]:
        """Drain `box` of the scheduler's orders (for the scheduler: of the runner's), and yield their content.

        Args:
            box: mailbox of the orders.
            models: expected kinds of messages, with the model of the content of each.
        """
        for _, orders in self.messages(box, *models, own=Records):  # an actor's results have the key of its jobs
            assert isinstance(orders, Orders | Jobs), "the models are of these"
            if orders.sender_epoch < self._orders_epoch:
                self.refuse("stale")
            elif (content := self.checked(schemas.read, models[type(orders)], orders.content)) is not None:
                self._orders_epoch = orders.sender_epoch
                yield content

    def is_stale(self, sender: str, epoch: int) -> bool:
        """Return whether a newer incarnation of a message's sender is known; count a refusal if so."""
        if epoch < self._sender_epochs.get(sender, -1):
            self.refuse("stale")
            return True
        self._sender_epochs[sender] = epoch
        return False

    def learner_news(self, box: Mailbox) -> Iterator[tuple[Level, WeightsMessage | Candidate]]:
        """Drain `box` of what learners publish, and yield all that comes from the newest learner of its level."""
        for _, message in self.messages(box, WeightsMessage, Candidate):
            level = message.level if isinstance(message, Candidate) else message.weights.level
            if not self.is_stale(f"learner-{level}", message.sender_epoch):
                yield level, message

    def newest_epoch(self, sender: str) -> int:
        """Return the newest epoch of a sender that `is_stale` was told of; 0 before."""
        return self._sender_epochs.get(sender, 0)

    def state_requests(self, box: Mailbox) -> list[Callable[[bytes], None]]:
        """Drain `box` of the scheduler's requests for this role's state, and return the functions that reply."""
        replies = []
        for reply, request in self.requests(box, Orders):
            wanted = self.checked(schemas.read, StateRequest, request.content)
            if wanted is None:
                continue
            if request.sender_epoch < self._orders_epoch or wanted.epoch > self.context.epoch:
                self.refuse("stale")  # of a scheduler that was replaced, or meant for the successor of this role
            else:
                replies.append(reply)
        return replies

    def reply_state(self, replies: Sequence[Callable[[bytes], None]], state: Callable[[], State]) -> None:
        """Reply to requests with what `state` returns, which is called in the background and owns all that it uses."""

        def encode_and_reply() -> None:
            payload = codec.encode(state())
            for reply in replies:
                reply(payload)

        if replies:
            self.in_background(encode_and_reply)

    def in_background(self, function: Callable[[], Result]) -> Future[Result]:
        """Run a function beside the steps; when it is done the role is woken, and an error of it ends the role."""
        future = self.context.background(function)
        if future.done():
            future.result()
        else:
            self._underway.append(future)
            future.add_done_callback(lambda _: self.context.wake.set())
        return future

    def _end_jobs(self) -> None:
        ended = [job for job in self._underway if job.done()]
        for job in ended:
            self._underway.remove(job)
            job.result()

    def checked(
        self, check: Callable[Arguments, Result], *arguments: Arguments.args, **options: Arguments.kwargs
    ) -> Result | None:
        """Return what `check` returns; count a refusal and return None where it raises `DecodeError`."""
        try:
            return check(*arguments, **options)
        except DecodeError as error:
            self.refuse(error.reason)
            return None

    def tell_sender(self, key: str, reason: str) -> None:
        """Tell the sender under `key` why its message was refused, where it can be told: by default it cannot."""
        return

    def refuse(self, reason: str) -> None:
        """Count a message that is not acted on; statistics report the count as `rejected_{reason}`."""
        self._refused[reason] += 1

    def event(self, now: float, event: str, **fields: float | str) -> None:
        """Publish an event with its fields for watchers."""
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
        known = {name: value for name, value in fields.items() if isinstance(value, str) or math.isfinite(value)}
        self.transport.publish(key, json.dumps({**about, **known}, allow_nan=False).encode(), json=True)
