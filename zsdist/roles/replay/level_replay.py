"""One level's part of a replay: what it holds, how large it may be, and at what pace it gives and takes.

What it takes in it writes into its journal, and only then may it be acknowledged. Another process's shelf goes on from
the journal: nothing that was acknowledged is lost, and what was not comes again.
"""

import json
from collections import deque
from enum import IntEnum
from pathlib import Path

import numpy as np

from zsdist.config import Config
from zsdist.protocol.inbox import Inbox
from zsdist.replay import segments
from zsdist.replay.buffer import RingBuffer
from zsdist.replay.journal import Journal, Record
from zsdist.replay.limiter import BAND, Limiter
from zsdist.replay.priorities import RowPriorities
from zsdist.roles.replay.shards import ReplayShard
from zsdist.roles.shapes import Shape
from zsdist.transport.base import Message
from zsdist.types import Level
from zsdist.wire import codec, frame
from zsdist.wire.messages import Push, SampleReply, State

HOLD_REQUEST_S = 0.3  # a request that cannot be served for so long is answered with "no batch yet"
PACE_EVERY_S = 0.05  # at most so long ago is what a journal knows of updates served; transitions it knows all


class Entry(IntEnum):
    """Kinds of records in the journal."""

    PUSH = 1  # a frame as it came, once all frames before it have come
    EPOCH = 2  # JSON: an actor and the epoch that was issued to it
    PACE = 3  # JSON: `LevelReplay.pace`


class LevelReplay:
    """One level's part of a shard of the replay: ring, sizes, limiter and inbox, with the requests that wait.

    Args:
        level: which.
        shape: of its transitions.
        config: of the run.
        shard: whose part it is.
        sender_epoch: incarnation of the replay.
        folder: for the journal, of this shelf and those before it in this start of the run.
    """

    def __init__(
        self, level: Level, shape: Shape, config: Config, shard: ReplayShard, sender_epoch: int, folder: Path
    ) -> None:
        self.level = level
        self.batch_size = config.replay.batch_initial
        settings, size = config.replay, shard.part(config.replay.size_initial)
        priorities = RowPriorities(size, settings.priority_exponent, settings.importance_exponent)
        self.buffer = RingBuffer(
            shape.state_size, shape.actions, size, settings.n_step, priorities if settings.prioritised else None
        )
        self.prioritised = 0  # rows whose priority was told anew
        self.inbox = Inbox(level, sender_epoch=sender_epoch)
        learning = config.high if level is Level.HIGH else config.low
        # Trajectories of both levels are complete when an option ends, so every car must be able to end one.
        grain = config.agent.option_max_steps * config.run.cars_per_actor
        self.limiter = Limiter(learning.updates_per_insert, shard.part(learning.min_size), grain, shard.part(BAND))
        self.rng = np.random.default_rng([config.seed, 0 if level is Level.HIGH else 1, shard.index])
        self._shard = shard
        self.stored = 0
        self.rejected: dict[str, int] = {}
        self.sampled = 0
        self.waiting: deque[tuple[float, Message, int]] = deque()  # since when, who asks, for how many batches
        self._epochs: dict[str, int] = {}  # newest issued since this start of the run
        self._closed: set[tuple[str, int]] = set()
        self.journal = Journal(folder)
        self.recovered = 0  # frames read from the journal
        self._entries: list[Record] = []  # to be written before the next acknowledgement
        self._in_pieces = 0  # rows written before this one are in the journal's pieces, if they are held
        self._pace: dict[str, int] = {}  # as the journal has it
        self._next_pace_s = 0.0

    def issue(self, actor: str, epoch: int) -> bool:
        """Admits a new epoch of an actor, closes the older one at its last frame in order; whether it was new."""
        current = self._epochs.get(actor, -1)
        if epoch <= current:
            return False
        if self._limited(actor, current):
            self.limiter.close(f"{actor}/{current}")
        self.inbox.issue(actor, epoch)
        self.limiter.open(f"{actor}/{epoch}")
        self._epochs[actor] = epoch
        self._entries.append((Entry.EPOCH, json.dumps([actor, epoch]).encode()))
        return True

    def receive(self, push: Push, payload: bytes, now: float) -> None:
        """Stores what of a frame is new and in order, and of frames that came before their time and now are.

        Args:
            push: the frame.
            payload: the bytes that it came in.
            now: the time.
        """
        for arrived in self.inbox.receive(push, now):
            stream = f"{arrived.actor}/{arrived.epoch}"
            stored, reasons = self.buffer.insert(arrived.trajectories)
            self.stored += stored
            for reason, count in reasons.items():
                self.rejected[reason] = self.rejected.get(reason, 0) + count
            self.limiter.count_inserts(stream, stored, rejected=sum(reasons.values()))
            if arrived.closes:
                self.limiter.close(stream)
                self._closed.add((arrived.actor, arrived.epoch))
            self._entries.append((Entry.PUSH, payload if arrived is push else codec.encode(arrived)))

    def credit(self, actor: str, epoch: int) -> int | None:
        """The absolute number of transitions an open epoch may produce; None: unlimited."""
        return self.limiter.credit(f"{actor}/{epoch}") if self._limited(actor, epoch) else 0

    def _limited(self, actor: str, epoch: int) -> bool:
        """Whether the limiter knows the epoch: issued since this start of the run, and not closed."""
        return self._epochs.get(actor) == epoch and (actor, epoch) not in self._closed

    def serve(self, now: float) -> None:
        """Answers waiting requests: with as many batches as the limiter allows, with none after `HOLD_REQUEST_S`.

        It waits until there is enough for all of them, so long as no actor has to wait for that: to wake a learner for
        a single batch costs as much as the update.
        """
        enough = min(sum(wanted for _, _, wanted in self.waiting), self.limiter.patience)
        if self.waiting and self.limiter.allowed < enough and now - self.waiting[0][0] < HOLD_REQUEST_S:
            return
        while self.waiting:
            asked_s, message, wanted = self.waiting[0]
            batch, batches, held = None, 0, len(self.buffer)
            while batches < wanted and held and self.limiter.allowed > 0:
                self.limiter.take_batch()
                batches += 1
            if batches:
                size = min(self.batch_size, held)
                batch = self.buffer.sample(self.rng, size, batches)
                self.sampled += batches * size
            elif now - asked_s < HOLD_REQUEST_S:
                return
            self.waiting.popleft()
            message.reply(codec.encode(SampleReply(self.level, batch, held, now - asked_s, max(1, batches))))

    def resize(self, buffer_size: int, batch_size: int) -> None:
        """Takes over the sizes that the scheduler derives from the returns (`zsdist.replay.sizing`).

        Args:
            buffer_size: of all shards together.
            batch_size: of a batch, which comes from one shard.
        """
        self.batch_size = batch_size
        self._hold(self._shard.part(buffer_size))

    def _hold(self, capacity: int) -> None:
        if capacity != self.buffer.capacity:
            self.buffer.resize(capacity)

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

    def pace(self) -> dict[str, int]:
        """What changes without any frame: updates served, transitions sampled, and the sizes in force.

        What was granted is not in it: the next replay grants anew, and its word replaces its predecessor's.
        """
        return {
            "updates": self.limiter.updates,
            "sampled": self.sampled,
            "batch_size": self.batch_size,
            "capacity": self.buffer.capacity,
        }

    def keep_pace(self, pace: dict[str, int]) -> None:
        """Takes over what `pace` gave."""
        self.limiter.resume_at(pace["updates"])
        self.sampled = pace["sampled"]
        self.batch_size = pace["batch_size"]
        self._hold(pace["capacity"])

    def state(self) -> tuple[dict, dict[str, np.ndarray]]:
        """Everything needed to go on: ring, sizes, limiter counts, books, generator state."""
        return self._standing(), self.buffer.state()

    def write_down(self, now: float) -> None:
        """Has the journal hold all that came; once this returns it may be acknowledged."""
        if now >= self._next_pace_s and (pace := self.pace()) != self._pace:
            self._entries.append((Entry.PACE, json.dumps(pace).encode()))
            self._pace, self._next_pace_s = pace, now + PACE_EVERY_S
        if self._entries:
            self.journal.append(self._entries)
            self._entries = []
        if self.journal.wants_base:
            self._begin_anew()

    def recover(self, restored: tuple[dict, dict[str, np.ndarray]] | None) -> None:
        """Goes on from the journal; where there is none, from a checkpoint's `state` or nothing, and begins one."""
        found = self.journal.recover()
        if found is None:
            if restored is not None:
                self.restore(*restored, same_run=False)
            self._begin_anew()
            return
        base = codec.decode(found.base, expect=State)
        parts = [(0, self.buffer.rows_since(0))]  # no row, but the columns
        for piece in found.pieces:
            part = codec.decode(piece, expect=State)
            parts.append((part.meta["first"], part.arrays))
        rows = segments.join(base.arrays, base.meta["held"], parts)
        self.restore(base.meta, rows, same_run=True)
        self._in_pieces = self.buffer.written
        for kind, content in found.records:
            if kind == Entry.PUSH:
                self.receive(codec.decode(content, expect=Push), content, 0.0)
                self.recovered += 1
            elif kind == Entry.EPOCH:
                self.issue(*json.loads(content))
            else:
                self.keep_pace(json.loads(content))
        self._entries.clear()  # they are there already

    def _begin_anew(self) -> None:
        """Folds the journal's log: rows that it brought become a piece, and all else is in the new base."""
        ring, name = self.buffer, self.level.value
        base = State(name, self._standing() | {"held": len(ring)}, ring.layout())
        rows = ring.rows_since(self._in_pieces)
        count = len(rows["actions"])
        piece = codec.encode(State(name, {"first": ring.written - count}, rows), packing=frame.PLAIN) if count else b""
        self.journal.rebase(codec.encode(base), piece, end=ring.written, oldest=ring.written - len(ring))
        self._in_pieces = ring.written

    def _standing(self) -> dict:
        """The first part of `state`."""
        return {
            "batch_size": self.batch_size,
            "limiter": self.limiter.state(),
            "inbox": self.inbox.state(),
            "stored": self.stored,
            "rejected": self.rejected,
            "sampled": self.sampled,
            "rng": json.dumps(self.rng.bit_generator.state),  # as text: its integers have 128 bits
            "books": self.books(),
            "epochs": self._epochs,
            "closed": [list(stream) for stream in sorted(self._closed)],
            "open": len(self.inbox.open_streams()),
        }

    def restore(self, meta: dict, arrays: dict[str, np.ndarray], *, same_run: bool) -> None:
        """Takes over a `state`.

        Args:
            meta: its first part.
            arrays: its second part.
            same_run: whether the actors of then still drive; else their epochs are over, and all have new ones.
        """
        self.batch_size = meta["batch_size"]
        self.inbox.restore(meta["inbox"])
        self.stored, self.rejected, self.sampled = meta["stored"], dict(meta["rejected"]), meta["sampled"]
        self.rng.bit_generator.state = json.loads(meta["rng"])
        self.buffer.restore(arrays)
        self.limiter.restore(meta["limiter"], same_run=same_run)
        if same_run:
            self._epochs = dict(meta["epochs"])
            self._closed = {(actor, epoch) for actor, epoch in meta["closed"]}
        else:
            for actor, epoch in self.inbox.open_streams():
                self.inbox.close(actor, epoch)  # the next of its name may push to another shard
