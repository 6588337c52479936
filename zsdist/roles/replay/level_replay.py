"""One level's part of a replay: its transitions and sizes, and the pace at which it accepts and serves them.

Whatever it accepts is written into its journal before it is acknowledged. A successor in another process resumes from
the journal: nothing that was acknowledged is lost, and everything else is sent again. Where a part of the journal is
damaged, that part alone is lost. It is counted, and the epochs that had frames in it go on behind them.
"""

import copy
import json
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from zsdist.common import random_streams
from zsdist.config import Config
from zsdist.protocol.inbox import Inbox
from zsdist.replay.buffer import RingBuffer
from zsdist.replay.limiter import BAND, Limiter
from zsdist.replay.priorities import RowPriorities
from zsdist.replay.ring_copy import RingCopy
from zsdist.roles.replay.level_journal import Entry, LevelJournal
from zsdist.roles.replay.shards import ReplayShard
from zsdist.roles.shapes import Shape
from zsdist.types import Level
from zsdist.wire import codec
from zsdist.wire.messages import Push, SampleReply

HOLD_REQUEST_S = 0.3  # a request that cannot be served for so long is answered with "no batch yet"


def credit_to_end_options(config: Config) -> int:
    """Return the credit that lets every car of an actor end its option, whatever the others do.

    The trajectories of both levels are complete when an option ends. A car notices that in its next step, for which it
    reserves credit as for any other: hence the one in addition.
    """
    longest = min(config.agent.option_max_steps, config.sim.max_steps)
    return (longest + 1) * config.run.cars_per_actor


class WaitingRequest(NamedTuple):
    """A learner's request that has not been answered yet.

    Attributes:
        since_s: time at which it arrived.
        reply: function that sends the answer.
        batches: number of batches requested.
    """

    since_s: float
    reply: Callable[[bytes], None]
    batches: int


class LevelReplay:
    """One level's part of a shard of the replay: ring buffer, sizes, limiter, inbox, and waiting requests.

    Args:
        level: level whose transitions it holds.
        shape: sizes of its transitions.
        config: configuration of the run.
        shard: shard that it belongs to.
        sender_epoch: epoch of the replay.
        folder: folder of the journal, shared with its predecessors in this start of the run.

    Attributes:
        lost_rows: transitions that the ring has lost with damaged pieces of journals.
        news: lines about damage that nobody has been told yet.
        journal: journal of all that is accepted.
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
        self.prioritised = 0  # rows whose priority a learner has updated
        self.inbox: Inbox[Push] = Inbox(level, sender_epoch=sender_epoch)
        learning = config.high if level is Level.HIGH else config.low
        self.limiter = Limiter(
            learning.updates_per_insert,
            shard.part(learning.min_size),
            credit_to_end_options(config),
            shard.part(BAND),
        )
        self.rng = random_streams.replay_sampling(config.seed, level is Level.HIGH, shard.index)
        self._shard = shard
        self.stored = 0
        self.rejected: dict[str, int] = {}
        self.sampled = 0
        self.waiting: deque[WaitingRequest] = deque()
        self.learner_epoch = -1  # of the newest learner that has asked in this start of the run
        self._learned_apart = 0  # updates that the limiter counts beyond those that the first learner knew of
        self._epochs: dict[str, int] = {}  # newest epoch of each actor, issued in this start of the run
        self._closed: set[tuple[str, int]] = set()
        self.lost_rows = 0
        self.news: list[str] = []
        self.journal = LevelJournal(folder, level, settings.fsync_ms)
        self.recovered = 0  # frames read from the journal

    def issue(self, actor: str, epoch: int) -> bool:
        """Accept an epoch of an actor and close its older one at the last frame in order; return whether it was new."""
        current = self._epochs.get(actor, -1)
        if epoch <= current:
            return False
        if self._limited(actor, current):
            self.limiter.close(f"{actor}/{current}")
        self._closed.discard((actor, current))
        self.inbox.issue(actor, epoch)
        self.limiter.open(f"{actor}/{epoch}")
        self._epochs[actor] = epoch
        self.journal.note_epoch(actor, epoch)
        return True

    def dismiss(self, actor: str, epoch: int) -> None:
        """Close an epoch of an actor that has left for good, at the last frame in order; again, it changes nothing.

        The journal has no record of it: a successor gets the same orders.
        """
        if self._limited(actor, epoch):
            self.limiter.close(f"{actor}/{epoch}")
            self.inbox.close(actor, epoch)
            self._closed.add((actor, epoch))

    def receive(self, push: Push, payload: bytes, now: float) -> None:
        """Store the trajectories of a frame, and of held frames that follow it in order.

        Args:
            push: frame that arrived.
            payload: bytes of the message with the frame.
            now: current time, seconds.
        """
        if push.first:
            self.skip(push.actor, push.epoch, push.sequence, push.produced - push.count)
        for frame in self.inbox.receive(push, now):
            stream = f"{frame.actor}/{frame.epoch}"
            stored, reasons = self.buffer.insert(frame.trajectories)
            self.stored += stored
            for reason, count in reasons.items():
                self.rejected[reason] = self.rejected.get(reason, 0) + count
            self.limiter.count_inserts(stream, stored, rejected=sum(reasons.values()))
            if frame.closes:
                self.limiter.close(stream)
                self._closed.add((frame.actor, frame.epoch))
            self.journal.note_frame(frame.actor, payload if frame is push else codec.encode(frame))

    def skip(self, actor: str, epoch: int, received: int, produced: int, closed: bool = False) -> None:
        """Go on behind acknowledged frames that are lost with a journal; their transitions count as rejected.

        Args:
            actor: name of the actor.
            epoch: its epoch.
            received: number of frames that were acknowledged.
            produced: running total at the last of them.
            closed: whether that one closed the epoch.
        """
        lost = self.inbox.skip(actor, epoch, received, produced, closed=closed)
        if lost is None:
            return
        if self._limited(actor, epoch):
            self.limiter.count_inserts(f"{actor}/{epoch}", 0, rejected=lost)
            if closed:
                self.limiter.close(f"{actor}/{epoch}")
                self._closed.add((actor, epoch))
        if lost:
            self.rejected["lost"] = self.rejected.get("lost", 0) + lost
        self.journal.note_progress(actor)
        self.news.append(f"{lost} acknowledged transitions of {actor} are lost with records of the journal")

    def credit(self, actor: str, epoch: int) -> int | None:
        """Return the absolute number of transitions that an epoch may produce; None: unlimited."""
        return self.limiter.credit(f"{actor}/{epoch}") if self._limited(actor, epoch) else 0

    def _limited(self, actor: str, epoch: int) -> bool:
        """Return whether the limiter knows the epoch: it was issued in this start of the run and is not closed."""
        return self._epochs.get(actor) == epoch and (actor, epoch) not in self._closed

    def follow_learner(self, epoch: int, updates: int) -> bool:
        """Note the incarnation of the learner that asks for batches; return false where a newer one is known.

        Batches that a learner took with it, and those whose updates its successor does not have, are given once more.
        So the ratio of updates to inserts holds for the networks that live on.

        Args:
            epoch: epoch of the learner.
            updates: number of updates of this shard's batches that its networks have had in the whole run.
        """
        if epoch < self.learner_epoch:
            return False
        if self.learner_epoch < 0:
            self._learned_apart = self.limiter.updates - updates
        elif epoch > self.learner_epoch:
            self.limiter.resume_at(min(self.limiter.updates, max(0, self._learned_apart + updates)))
            self.waiting.clear()  # its predecessor's
        self.learner_epoch = epoch
        return True

    def serve(self, now: float) -> None:
        """Answer waiting requests with as many batches as the limiter allows; with none after `HOLD_REQUEST_S`.

        Requests wait until there is enough for all of them, as long as no actor has to wait for that: waking a learner
        for a single batch costs as much as the update.
        """
        enough = min(sum(request.batches for request in self.waiting), self.limiter.patience)
        if self.waiting and self.limiter.allowed < enough and now - self.waiting[0].since_s < HOLD_REQUEST_S:
            return
        while self.waiting:
            since_s, reply, wanted = self.waiting[0]
            batch, batches, held = None, 0, len(self.buffer)
            while batches < wanted and held and self.limiter.allowed > 0:
                self.limiter.take_batch()
                batches += 1
            if batches:
                size = min(self.batch_size, held)
                batch = self.buffer.sample(self.rng, size, batches)
                self.sampled += batches * size
            elif now - since_s < HOLD_REQUEST_S:
                return
            self.waiting.popleft()
            reply(codec.encode(SampleReply(self.level, batch, held, now - since_s, max(1, batches))))

    def resize(self, buffer_size: int, batch_size: int) -> None:
        """Apply the scheduler's sizes: transitions in all shards together, and in a batch, which is from one shard."""
        self.batch_size = batch_size
        self._set_capacity(self._shard.part(buffer_size))

    def _set_capacity(self, capacity: int) -> None:
        if capacity != self.buffer.capacity:
            self.buffer.resize(capacity)

    def counts(self) -> dict[str, int]:
        """Return the counts of transitions; `produced = stored + rejected` once all epochs are closed.

        Those that were lost before they were stored again are among the rejected, those lost from the ring are not.
        """
        return {
            "produced": self.inbox.produced,
            "stored": self.stored,
            "duplicates": self.inbox.duplicates,
            "rejected": sum(self.rejected.values()),
            "lost": self.rejected.get("lost", 0),
            "lost_rows": self.lost_rows,
            "abandoned_at_most": self.inbox.abandoned_at_most,
            "sampled": self.sampled,
        }

    def pace(self) -> dict[str, int]:
        """Return the values that change without a frame: updates served, transitions sampled, and the present sizes.

        Granted credit is not among them: a successor grants credit anew.
        """
        return {
            "updates": self.limiter.updates,
            "sampled": self.sampled,
            "batch_size": self.batch_size,
            "capacity": self.buffer.capacity,
            "learner_epoch": self.learner_epoch,
            "learned_apart": self._learned_apart,
        }

    def restore_pace(self, pace: dict[str, int]) -> None:
        """Apply values that `pace` returned."""
        self.limiter.resume_at(pace["updates"])
        self.sampled = pace["sampled"]
        self.batch_size = pace["batch_size"]
        self._set_capacity(pace["capacity"])
        self.learner_epoch, self._learned_apart = pace.get("learner_epoch", -1), pace.get("learned_apart", 0)

    def state(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return all that a successor needs: sizes, limiter, inbox, counts and generator as JSON, and the ring."""
        return self._meta(), self.buffer.state()

    def begin_copy(self) -> tuple[dict[str, Any], RingCopy]:
        """Return `state` as it is now, the ring as a copy that is still to be made."""
        return copy.deepcopy(self._meta()), self.buffer.begin_copy()

    def write_journal(self, now: float) -> None:
        """Write all that has been accepted into the journal, which says when it may be acknowledged."""
        self.journal.write(now, self.pace, self.inbox.progress)
        if self.journal.wants_base:
            self.journal.compact(self._meta(), self.buffer)
        self.journal.sync(now)

    def recover(self, restored: tuple[dict[str, Any], dict[str, np.ndarray]] | None, launch: int = 0) -> None:
        """Resume from the journal; where there is none, begin one, from a checkpoint's `state` or from nothing.

        Args:
            restored: parts of the state in a checkpoint.
            launch: epoch of the runner; actors with older epochs in the journal are gone.
        """
        found = self.journal.recover(self.buffer.rows_since(0))
        if found is None:
            if restored is not None:
                self.restore(*restored, same_run=False)
            self.journal.compact(self._meta(), self.buffer)
            return
        self.restore(found.meta, found.rows, same_run=True)
        self.lost_rows += found.lost
        self.news += found.damage
        for kind, content in found.records:
            _replay(self, kind, content)
        for actor, epoch in self._epochs.items():
            if epoch < launch:
                self.dismiss(actor, epoch)
        self.journal.forget()  # it has them already
        if self.news:
            self.journal.compact(self._meta(), self.buffer)  # so that no damage is found twice

    def _meta(self) -> dict[str, Any]:
        """Return the first part of `state`."""
        return {
            "batch_size": self.batch_size,
            "limiter": self.limiter.state(),
            "inbox": self.inbox.state(),
            "stored": self.stored,
            "rejected": self.rejected,
            "sampled": self.sampled,
            "lost_rows": self.lost_rows,
            "rng": json.dumps(self.rng.bit_generator.state),  # as text: its integers have 128 bits
            "books": self.counts(),
            "learner": [self.learner_epoch, self._learned_apart],
            "epochs": self._epochs,
            "closed": [list(stream) for stream in sorted(self._closed)],
            "open": len(self.inbox.open_streams()),
        }

    def restore(self, meta: dict[str, Any], arrays: dict[str, np.ndarray], *, same_run: bool) -> None:
        """Restore a `state`.

        Args:
            meta: first part of the state.
            arrays: second part of the state.
            same_run: whether the state is from this start of the run, whose actors still drive; else all actors have
                new epochs.
        """
        self.batch_size = meta["batch_size"]
        self.inbox.restore(meta["inbox"])
        self.stored, self.rejected, self.sampled = meta["stored"], dict(meta["rejected"]), meta["sampled"]
        self.lost_rows = meta.get("lost_rows", 0)  # states of earlier versions do not count them
        self.rng.bit_generator.state = json.loads(meta["rng"])
        self.buffer.restore(arrays)
        self.limiter.restore(meta["limiter"], same_run=same_run)
        if same_run:
            self.learner_epoch, self._learned_apart = meta.get("learner", (-1, 0))
            self._epochs = dict(meta["epochs"])
            self._closed = {(actor, epoch) for actor, epoch in meta["closed"]}
        else:
            for actor, epoch in self.inbox.open_streams():
                self.inbox.close(actor, epoch)  # the actor's next incarnation may push to another shard


def _replay(level_replay: LevelReplay, kind: int, content: bytes) -> None:
    """Do again what a record of a journal says, after what it implies about records that are lost."""
    if kind == Entry.PUSH:
        push = codec.decode(content, expect=Push)
        level_replay.issue(push.actor, push.epoch)
        level_replay.skip(push.actor, push.epoch, push.sequence, push.produced - push.count)
        level_replay.receive(push, content, 0.0)
        level_replay.recovered += 1
    elif kind == Entry.EPOCH:
        level_replay.issue(*json.loads(content))
    elif kind == Entry.HEADS:
        for actor, epoch, received, produced, closed in json.loads(content):
            level_replay.issue(actor, epoch)
            level_replay.skip(actor, epoch, received, produced, closed)
    else:
        level_replay.restore_pace(json.loads(content))
