"""The replay role: stores both levels' transitions, sizes itself by the reward, and paces actors and learners."""

import json
from collections import deque
from dataclasses import dataclass

import numpy as np

from zsdist.config import Config
from zsdist.protocol.inbox import Inbox
from zsdist.replay.buffer import RingBuffer
from zsdist.replay.limiter import Limiter
from zsdist.roles.base import HEARTBEAT_S, Context, Role
from zsdist.transport.base import Message
from zsdist.types import Level
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders, Push, SampleReply, SampleRequest, State

HOLD_REQUEST_S = 2.0  # a request that cannot be served for so long is answered with "no batch yet"


@dataclass(frozen=True)
class Shape:
    """What one level's transitions look like: state features and actions."""

    state_size: int
    actions: int


class Shelf:
    """One level's part of the replay: ring, sizes, limiter and inbox, with the requests that wait for data."""

    def __init__(self, level: Level, shape: Shape, config: Config, sender_epoch: int) -> None:
        self.level = level
        self.batch_size = config.replay.batch_initial
        self.buffer = RingBuffer(shape.state_size, shape.actions, config.replay.size_initial)
        self.inbox = Inbox(level, sender_epoch=sender_epoch)
        learning = config.high if level is Level.HIGH else config.low
        # Trajectories of both levels are complete when an option ends, so every car must be able to end one.
        grain = config.agent.option_max_steps * config.run.cars_per_actor
        self.limiter = Limiter(learning.updates_per_insert, learning.min_size, grain)
        self.rng = np.random.default_rng([config.seed, 0 if level is Level.HIGH else 1])
        self.stored = 0
        self.rejected: dict[str, int] = {}
        self.sampled = 0
        self.waiting: deque[tuple[float, Message]] = deque()
        self._epochs: dict[str, int] = {}  # newest issued since this process began
        self._closed: set[tuple[str, int]] = set()

    def issue(self, actor: str, epoch: int) -> None:
        """Admits a newly issued epoch of an actor; its older epoch is closed where its last contiguous frame ended."""
        current = self._epochs.get(actor, -1)
        if epoch <= current:
            return
        if self._limited(actor, current):
            self.limiter.close(f"{actor}/{current}")
        self.inbox.issue(actor, epoch)
        self.limiter.open(f"{actor}/{epoch}")
        self._epochs[actor] = epoch

    def receive(self, push: Push, now: float) -> None:
        """Stores what of a frame is new and in order."""
        for frame in self.inbox.receive(push, now):
            stream = f"{frame.actor}/{frame.epoch}"
            stored, reasons = self.buffer.insert(*frame.trajectories)
            self.stored += stored
            for reason, count in reasons.items():
                self.rejected[reason] = self.rejected.get(reason, 0) + count
            self.limiter.inserted(stream, stored, rejected=sum(reasons.values()))
            if frame.closes:
                self.limiter.close(stream)
                self._closed.add((frame.actor, frame.epoch))

    def credit(self, actor: str, epoch: int) -> int | None:
        """The absolute number of transitions an open epoch may produce; None: unlimited."""
        return self.limiter.credit(f"{actor}/{epoch}") if self._limited(actor, epoch) else 0

    def _limited(self, actor: str, epoch: int) -> bool:
        """Whether the limiter knows the epoch: issued since this process began, and not closed."""
        return self._epochs.get(actor) == epoch and (actor, epoch) not in self._closed

    def serve(self, now: float) -> None:
        """Answers waiting requests: with a batch while the limiter allows, with none after `HOLD_REQUEST_S`."""
        while self.waiting:
            asked_s, message = self.waiting[0]
            batch = None
            if len(self.buffer) and self.limiter.may_sample():
                size = min(self.batch_size, len(self.buffer))
                batch = self.buffer.sample(self.rng, size)
                self.limiter.sampled()
                self.sampled += size
            elif now - asked_s < HOLD_REQUEST_S:
                return
            self.waiting.popleft()
            message.reply(codec.encode(SampleReply(self.level, batch, {"stored": len(self.buffer)})))

    def resize(self, buffer_size: int, batch_size: int) -> None:
        """Takes over the sizes that the scheduler derives from the returns (`zsdist.replay.sizing`)."""
        self.batch_size = batch_size
        if buffer_size != self.buffer.capacity:
            self.buffer.resize(buffer_size)

    def books(self) -> dict[str, int]:
        """What was produced and what became of it; `produced = stored + rejected` once all epochs are closed."""
        return {
            "produced": self.inbox.produced,
            "stored": self.stored,
            "duplicates": self.inbox.duplicates,
            "rejected": sum(self.rejected.values()),
            "abandoned_at_most": self.inbox.abandoned_at_most,
            "sampled": self.sampled,
        }


class Replay(Role):
    """Both levels' shelves behind one set of mailboxes."""

    def __init__(self, context: Context, shapes: dict[Level, Shape], restored: State | None = None) -> None:
        super().__init__(context)
        run = context.run
        self.shelves = {level: Shelf(level, shape, context.config, context.epoch) for level, shape in shapes.items()}
        if restored is not None:
            self._restore(restored)
        self._scheduler_epoch = -1
        self._pushes = self.mailbox("push")
        self._requests = self.mailbox("sample")
        self._orders = self.mailbox("orders")
        self._checkpoints = self.mailbox("checkpoint")
        self.transport.subscribe(keys.push(run, keys.ANY, keys.ANY, keys.ANY), self._pushes)
        for level in self.shelves:
            self.transport.serve(keys.sample(run, level), self._requests)
        self.transport.serve(keys.control(run, "replay"), self._checkpoints)
        self.transport.subscribe(keys.control(run, "replay"), self._orders, retained=True)

    def work(self, now: float) -> float:
        """Stores what has come, answers who may be answered, acknowledges and grants credit."""
        for _, orders in self.messages(self._orders):
            if isinstance(orders, Orders) and orders.sender_epoch >= self._scheduler_epoch:
                self._scheduler_epoch = orders.sender_epoch
                self._follow(orders.content)
        for _, push in self.messages(self._pushes):
            if isinstance(push, Push):
                self.shelves[push.stream].receive(push, now)
        for message, request in self.messages(self._requests):
            if isinstance(request, SampleRequest):
                self.shelves[request.level].waiting.append((now, message))
        wake_s = now + HEARTBEAT_S
        for shelf in self.shelves.values():
            shelf.serve(now)
            for ack in shelf.inbox.acks(now, shelf.credit):
                self.transport.publish(keys.ack(self.context.run, ack.actor), codec.encode(ack))
            wake_s = min(wake_s, shelf.inbox.next_wake(now) or wake_s)
        for message in self._checkpoints.drain():
            message.reply(codec.encode(self.state()))
        return wake_s

    def statistics(self) -> dict[str, float | str]:
        """Books, sizes and pace of both levels."""
        fields: dict[str, float | str] = {}
        for level, shelf in self.shelves.items():
            books = {f"{level}_{name}": count for name, count in shelf.books().items()}
            fields |= books | {
                f"{level}_size": len(shelf.buffer),
                f"{level}_capacity": shelf.buffer.capacity,
                f"{level}_batch_size": shelf.batch_size,
                f"{level}_updates_served": shelf.limiter.updates,
                f"{level}_samples_per_insert": round(shelf.sampled / max(1, shelf.stored), 3),
                f"{level}_waiting_requests": len(shelf.waiting),
                f"{level}_bytes": shelf.buffer.nbytes,
            }
            if len(shelf.buffer):
                fields[f"{level}_oldest_version"] = shelf.buffer.oldest_version
            fields |= {f"{level}_refused_{reason}": count for reason, count in shelf.inbox.refused.items()}
        return fields

    def state(self) -> State:
        """Everything needed to go on: rings, sizes, limiter counts, books, generator states."""
        meta, arrays = {}, {}
        for level, shelf in self.shelves.items():
            meta[level.value] = {
                "batch_size": shelf.batch_size,
                "limiter": shelf.limiter.state(),
                "inbox": shelf.inbox.state(),
                "stored": shelf.stored,
                "rejected": shelf.rejected,
                "sampled": shelf.sampled,
                "rng": json.dumps(shelf.rng.bit_generator.state),  # as text: its integers have 128 bits
                "books": shelf.books(),
                "open": len(shelf.inbox.open_streams()),
            }
            arrays |= {f"{level}/{name}": array for name, array in shelf.buffer.state().items()}
        return State("replay", meta, arrays)

    def _restore(self, state: State) -> None:
        for level, shelf in self.shelves.items():
            meta = state.meta[level.value]
            shelf.batch_size = meta["batch_size"]
            shelf.inbox.restore(meta["inbox"])
            shelf.stored, shelf.rejected, shelf.sampled = meta["stored"], dict(meta["rejected"]), meta["sampled"]
            shelf.rng.bit_generator.state = json.loads(meta["rng"])
            shelf.buffer.restore(state.part(f"{level}/"))
            shelf.limiter.restore(meta["limiter"])

    def _follow(self, content: dict) -> None:
        for actor, epoch in content["epochs"].items():
            for shelf in self.shelves.values():
                shelf.issue(actor, epoch)
        for shelf in self.shelves.values():
            shelf.resize(content["buffer_size"], content["batch_size"])
        self.finished = content["stop"]
