"""Replay role: stores both levels' transitions, in sizes that follow the reward, and paces actors and learners.

Each level's replay writes accepted frames into a journal before they are acknowledged. The successor of a replay
that died resumes from the journals.
"""

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from zsdist.common.console import say
from zsdist.recording.recorded_set import RecordedSet
from zsdist.roles.base import HEARTBEAT_S, Context, Role
from zsdist.roles.replay import start
from zsdist.roles.replay.level_replay import LevelReplay, WaitingRequest
from zsdist.roles.replay.shards import ROLE, ReplayShard
from zsdist.roles.schemas import ReplayOrders
from zsdist.roles.shapes import Shape
from zsdist.types import Level
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders, Priorities, Push, SampleRequest, State

EVENT_LENGTH = 1000  # most characters of an event about damage; the log of the role has all
COPY_BYTES = 8 * 2**20  # of the rings, copied in a step for a checkpoint
MAX_WAITING = 256  # requests of a level; a learner has a few at a time


class Replay(Role):
    """Both levels' replays of one shard behind one set of mailboxes.

    Args:
        context: identity of the role.
        shapes: sizes of each level's transitions.
        folder: folder of the journals, shared with this replay's predecessors in this start of the run.
        restored: state in a checkpoint; used only if there are no journals yet.
        recorded: sets from whose transitions a new run starts.

    Raises:
        DataError: a recorded set is damaged.
    """

    def __init__(
        self,
        context: Context,
        shapes: dict[Level, Shape],
        folder: Path,
        restored: State | None = None,
        recorded: Sequence[RecordedSet] = (),
    ) -> None:
        super().__init__(context)
        run = context.run
        self.shard = ReplayShard.of(context.config, int(context.id))
        self.level_replays: dict[Level, LevelReplay] = {}
        self._folder = folder
        self._asking: list[Callable[[bytes], None]] = []  # replies to requests for the state
        self._copying: _StateCopy | None = None
        for level, shape in shapes.items():
            level_replay = LevelReplay(level, shape, context.config, self.shard, context.epoch, folder / level)
            saved = (restored.meta[level.value], restored.part(f"{level}/")) if restored else None
            level_replay.recover(saved, context.launch)
            if recorded:
                shards = context.config.replay.shards
                start.fill(level_replay, start.trajectories(recorded, level, self.shard.index, shards))
            self.level_replays[level] = level_replay
        self._pushes = self.mailbox("push")
        self._requests = self.mailbox("sample")
        self._errors = self.mailbox("priority")
        self._orders = self.mailbox("orders")
        self._checkpoints = self.mailbox("checkpoint")
        self._heard: set[str] = set()  # actors to whose pushes it has subscribed; `ANY`: to those of all
        for actor in sorted(self.shard.actors or (keys.ANY,)):
            self._hear(actor)
        for level in self.level_replays:
            self.transport.serve(keys.sample(run, level, self.shard.index), self._requests)
            if context.config.replay.prioritised:
                self.transport.subscribe(keys.priority(run, level, self.shard.index), self._errors)
        self.transport.serve(keys.control(run, self.shard.name), self._checkpoints)
        self.transport.subscribe(keys.control(run, ROLE), self._orders, retained=True)

    @property
    def recovered(self) -> int:
        """Number of frames read from the journals."""
        return sum(level_replay.recovered for level_replay in self.level_replays.values())

    def work(self, now: float) -> float:
        """Store pushes and serve requests; write the journals, then acknowledge and grant credit."""
        for content in self.orders(self._orders, {Orders: ReplayOrders}):
            self._follow(content)
        for message, push in self.messages(self._pushes, Push):
            self.level_replays[push.stream].receive(push, message.payload, now)
        for _, priorities in self.messages(self._errors, Priorities):
            level_replay = self.level_replays[priorities.level]
            if priorities.sender_epoch < level_replay.learner_epoch:
                self.refuse("stale")
                continue
            level_replay.prioritised += level_replay.buffer.update_priorities(priorities.serials, priorities.errors)
        for reply, request in self.requests(self._requests, SampleRequest):
            waiting = self.level_replays[request.level].waiting
            if not self.level_replays[request.level].follow_learner(request.sender_epoch, request.updates):
                self.refuse("stale")
            elif len(waiting) < MAX_WAITING:
                waiting.append(WaitingRequest(now, reply, request.batches))
            else:
                self.refuse("requests")
        for level_replay in self.level_replays.values():
            level_replay.serve(now)
            level_replay.write_journal(now)
        self._report_damage(now)
        wake_s = now + HEARTBEAT_S
        for level_replay in self.level_replays.values():
            if level_replay.journal.acknowledges_at > now:
                wake_s = min(wake_s, level_replay.journal.acknowledges_at)
                continue
            for ack in level_replay.inbox.acks(now, level_replay.credit):
                self.transport.publish(keys.ack(self.context.run, ack.actor), codec.encode(ack))
            wake_s = min(wake_s, level_replay.inbox.next_wake(now) or wake_s)
        if self._answer_states():
            wake_s = now
        if self.finished:
            for level_replay in self.level_replays.values():
                level_replay.journal.close()
            shutil.rmtree(self._folder, ignore_errors=True)  # the last checkpoint holds everything
        return wake_s

    def tell_sender(self, key: str, reason: str) -> None:
        """Tell an actor why its push was refused, by its acknowledgements."""
        parsed = keys.parse(key)
        if parsed is not None and parsed.kind == "push" and parsed.fields["level"] in self.level_replays:
            inbox = self.level_replays[Level(parsed.fields["level"])].inbox
            inbox.note_refusal(parsed.fields["actor"], int(parsed.fields["epoch"]), reason)

    def statistics(self) -> dict[str, float | str]:
        """Return counts, sizes and pace of both levels, and the size of the journals."""
        fields: dict[str, float | str] = {
            "journal_bytes": sum(level_replay.journal.nbytes for level_replay in self.level_replays.values()),
            "recovered_frames": self.recovered,
        }
        for level, level_replay in self.level_replays.items():
            buffer = level_replay.buffer
            counts = {f"{level}_{name}": count for name, count in level_replay.counts().items()}
            fields |= counts | {
                f"{level}_size": len(buffer),
                f"{level}_capacity": buffer.capacity,
                f"{level}_batch_size": level_replay.batch_size,
                f"{level}_updates_served": level_replay.limiter.updates,
                f"{level}_samples_per_insert": round(level_replay.sampled / max(1, level_replay.stored), 3),
                f"{level}_waiting_requests": len(level_replay.waiting),
                f"{level}_transitions_lacking": level_replay.limiter.lacking,
                f"{level}_bytes": buffer.nbytes,
            }
            if self.config.replay.prioritised:
                fields[f"{level}_prioritised"] = level_replay.prioritised
            if buffer.oldest_version is not None and buffer.oldest_age_versions is not None:
                fields[f"{level}_oldest_version"] = buffer.oldest_version
                fields[f"{level}_oldest_age_versions"] = buffer.oldest_age_versions
            fields |= {f"{level}_refused_{reason}": count for reason, count in level_replay.inbox.refused.items()}
        return fields

    def state(self) -> State:
        """Return all that a successor needs to resume."""
        meta: dict[str, Any] = {}
        arrays: dict[str, np.ndarray] = {}
        for level, level_replay in self.level_replays.items():
            meta[level.value], columns = level_replay.state()
            arrays |= {f"{level}/{name}": array for name, array in columns.items()}
        return State(self.shard.name, meta, arrays)

    def _report_damage(self, now: float) -> None:
        """Tell watchers, and the log of this role, what was found damaged and what is lost with it."""
        lines = [
            f"{level} level: {line}" for level, level_replay in self.level_replays.items() for line in level_replay.news
        ]
        if not lines:
            return
        for line in lines:
            say(f"{self.shard.name}: {line}", error=True)
        for level_replay in self.level_replays.values():
            level_replay.news.clear()
        self.event(now, "journal_damaged", what="; ".join(lines)[:EVENT_LENGTH])

    def _answer_states(self) -> bool:
        """Copy a slice of the state that was asked for, and reply when all is copied; return whether more is to do."""
        self._asking += self.state_requests(self._checkpoints)
        if self._copying is None and self._asking:
            self._copying, self._asking = _StateCopy(self.shard.name, self.level_replays, self._asking), []
        if self._copying is not None and self._copying.advance(COPY_BYTES):
            self.reply_state(self._copying.replies, self._copying.state)
            self._copying = None
        return self._copying is not None or bool(self._asking)

    def _hear(self, actor: str) -> None:
        """Subscribe to the pushes of an actor, once."""
        if actor not in self._heard and keys.ANY not in self._heard:
            self._heard.add(actor)
            self.transport.subscribe(keys.push(self.context.run, keys.ANY, actor, keys.ANY), self._pushes)

    def _follow(self, content: ReplayOrders) -> None:
        limits = self.config.replay
        if content.buffer_size > limits.size_max or content.batch_size > limits.batch_max:
            self.refuse("size")
            return
        for actor, epoch in content.epochs.items():
            if self.shard.owns(actor):
                self._hear(actor)
                for level_replay in self.level_replays.values():
                    level_replay.issue(actor, epoch)
        for actor, epoch in content.left.items():
            for level_replay in self.level_replays.values():
                level_replay.dismiss(actor, epoch)
        for level_replay in self.level_replays.values():
            level_replay.resize(content.buffer_size, content.batch_size)
        self.finished = content.stop


class _StateCopy:
    """Copy of a shard's state as it was at one moment.

    Attributes:
        replies: functions that reply to the requests that came before that moment.
    """

    def __init__(
        self, name: str, level_replays: Mapping[Level, LevelReplay], replies: Sequence[Callable[[bytes], None]]
    ) -> None:
        self.replies = replies
        self._name = name
        self._parts = {level: level_replay.begin_copy() for level, level_replay in level_replays.items()}

    def advance(self, most_bytes: int) -> bool:
        """Copy a slice; return whether all is copied."""
        for _, ring in self._parts.values():
            while not ring.done and most_bytes > 0:
                most_bytes -= ring.advance(most_bytes)
        return all(ring.done for _, ring in self._parts.values())

    def state(self) -> State:
        """Return the copied state."""
        meta = {level.value: part for level, (part, _) in self._parts.items()}
        rings = {level: ring.arrays() for level, (_, ring) in self._parts.items()}
        return State(
            self._name, meta, {f"{at}/{name}": array for at, ring in rings.items() for name, array in ring.items()}
        )
