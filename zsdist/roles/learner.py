"""Learner role, one class for both levels: requests batches, updates its DQN, publishes weights, joins in merges."""

import itertools
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from zsdist.dqn import batches, network
from zsdist.dqn.base import BaseDqnLearner
from zsdist.dqn.soundness import UnsoundUpdateError
from zsdist.errors import RunError
from zsdist.roles import divergence
from zsdist.roles.base import Context, Role
from zsdist.roles.kept_state import KeptState, MergeState
from zsdist.roles.promotion import promoted
from zsdist.roles.rollback import Rollbacks, not_finite
from zsdist.roles.schemas import BEST, DISTILLED, RECENT, CandidateName, LearnerOrders
from zsdist.types import Batch, Level, Parameters, Weights
from zsdist.wire import codec, keys
from zsdist.wire.messages import (
    Candidate,
    Orders,
    Priorities,
    SampleReply,
    SampleRequest,
    State,
    WeightsMessage,
)

PREFETCH = 16  # batches of a shard requested or ready, enough until the next answer arrives
BATCHES_AN_ANSWER = 4  # requested at once, since a message costs more than carrying one more batch
UPDATES_A_STEP = 8  # before the mailboxes are read again
ANSWER_WITHIN_S = 4.0  # timeout of a request in the transport
ASK_AGAIN_AFTER_S = 0.6  # a live replay answers sooner; one that died, or its hub, may be back by now
WEIGHTS_EVERY_S = 0.5
REPEAT_EVERY_S = 2.0  # unchanged weights and pending candidates are published again, in case a message was dropped
DISTIL_BATCHES = 32  # most recent batches, which distillation learns from


class _ShardSource:
    """One shard of the replay as a source of batches: pending requests, ready batches, and its size."""

    def __init__(self) -> None:
        self.ready: deque[Batch] = deque()
        self.asked_s: deque[float] = deque()  # times of the pending requests, for `BATCHES_AN_ANSWER` each
        self.held = 1  # transitions in the shard
        self.served = 0
        self.learned = 0  # batches in the whole run whose updates are in the present networks

    @property
    def coming(self) -> int:
        """Number of batches that are ready or requested."""
        return len(self.ready) + BATCHES_AN_ANSWER * len(self.asked_s)

    @property
    def turn(self) -> float:
        """Rank of the shard, lowest first, so that each gives batches in proportion to what it holds."""
        return (self.served + 1) / self.held


class Learner(Role):
    """Learner of the online and target network of one level.

    Args:
        context: identity of the role.
        level: level that it learns.
        dqn: networks and optimiser.
        restored: state from which it goes on; None: `dqn` as it is.
        kept: place where its state is kept for a successor; None: it has no successor.
        refused: folder for updates that were refused (`zsdist.roles.rollback`); None: they are not written.
    """

    def __init__(
        self,
        context: Context,
        level: Level,
        dqn: BaseDqnLearner,
        restored: State | None = None,
        kept: KeptState | None = None,
        refused: Path | None = None,
    ) -> None:
        super().__init__(context)
        self.level = level
        self.dqn = dqn
        self.version = 0  # version of the weights last broadcast
        self.updates = 0
        self.merge = 0  # index of the last merge whose winner was taken over
        self.waiting_data_s = 0.0
        self.waiting_reply_s = 0.0  # the part of `waiting_data_s` in which the replay had a batch to give
        self._best: Parameters | None = None
        self._candidates: dict[CandidateName, Parameters] = {}
        self._offered = 0
        self._episodes = 0  # finished ones of the run, as far as is known here
        dqn.limit = divergence.value_limit(context.config, level)
        self._paused = False
        self._recent_batches: deque[Batch] = deque(maxlen=DISTIL_BATCHES)
        self._sources = [_ShardSource() for _ in range(context.config.replay.shards)]
        self._batch_size = 0  # batch size of the last update
        self._starved_since_s: float | None = None
        self._published_updates = -1
        self._published_s = -REPEAT_EVERY_S
        self._made_s = 0.0  # time at which the version last broadcast was made
        self._offered_s = 0.0
        self._kept = kept
        self._kept_updates = -1
        self._worked_s = 0.0
        if restored is not None:
            self._restore(restored)
        self._rollbacks = Rollbacks(dqn, context.config, level, refused)
        run = context.run
        self._orders = self.mailbox("orders")
        self._batches = self.mailbox("batches")
        self._checkpoints = self.mailbox("checkpoint")
        self.transport.serve(keys.control(run, context.name), self._checkpoints)
        self.transport.subscribe(keys.control(run, "learner"), self._orders, retained=True)

    def work(self, now: float) -> float:
        """Follow orders, learn from the batches that have arrived, request more, and publish new weights."""
        self._worked_s = now
        for content in self.orders(self._orders, {Orders: LearnerOrders}):
            self._follow(content, now)
        self._receive(now)
        learned = self._learn(now)
        if self._kept is not None and self.updates != self._kept_updates and self._kept.is_due(now):
            self._keep(now)
        self._publish(now)
        if replies := self.state_requests(self._checkpoints):
            if self.updates != self._published_updates:  # so that a checkpoint's weights have their own version
                self._publish_weights(now)
            self.reply_state(replies, self.capture(now))
        # After an update, work again at once: waiting begins when there is no batch then.
        return now if learned else now + WEIGHTS_EVERY_S

    def statistics(self) -> dict[str, float | str]:
        """Return updates, losses, version, and the time spent waiting for data."""
        return {
            "learner_updates": self.updates,
            "weight_version": self.version,
            "merges": self.merge,
            "rollbacks": self._rollbacks.count,
            "waiting_data_s": round(self.waiting_data_s, 3),
            "waiting_reply_s": round(self.waiting_reply_s, 3),
            **{name: round(value, 6) for name, value in self.dqn.figures().items()},
            **({"batch_size": self._batch_size} if self._batch_size else {}),
        }

    def state(self) -> State:
        """Return networks, optimiser, generator and counts."""
        return self.capture(self._worked_s)()

    def capture(self, now: float) -> Callable[[], State]:
        """Copy the state, and return a function that makes a `State` of the copy, on any thread."""
        arrays = {f"dqn/{name}": array for name, array in self._sound("state", self.dqn.state, now).items()}
        arrays |= {f"best/{name}": array for name, array in (self._best or {}).items()}
        meta: dict[str, Any] = {"version": self.version, "updates": self.updates, "merge": self.merge}
        meta["learned"] = [source.learned for source in self._sources]

        def make() -> State:
            state = State(self.context.name, meta, arrays)
            return State(state.role, meta | {"sha256": network.sha256(state.part("dqn/online/"))}, arrays)

        return make

    def continue_after(self, published: int) -> None:
        """Publish only versions of weights beyond `published`, which predecessors have used up."""
        self.version = max(self.version, published)

    def _keep(self, now: float) -> None:
        """Keep the state for a successor, with the candidates of a merge under way."""
        if self._kept is not None:
            merge = MergeState(self._offered, self._candidates, self._paused)
            self._kept.keep(lambda: merge.added_to(self.state()), now)
            self._kept_updates = self.updates

    def _restore(self, state: State) -> None:
        self.dqn.restore(state.part("dqn/"))
        self._best = state.part("best/") or None
        self.version, self.updates, self.merge = (state.meta[name] for name in ("version", "updates", "merge"))
        self._offered, self._candidates, self._paused = MergeState.of(state) or (self.merge, {}, False)
        for source, learned in zip(self._sources, state.meta.get("learned", ()), strict=False):
            source.learned = learned

    def _receive(self, now: float) -> None:
        lacked_s: float | None = None  # longest time for which a shard had no batch to give; None: none has answered
        for message, reply in self.messages(self._batches, SampleReply):
            batch = None if reply.batch is None else batches.from_stored(reply.batch)
            if batch is not None and not self.dqn.fits(batch):
                self.refuse("shape")
                continue
            key = keys.parse(message.key)
            assert key is not None  # `messages` has checked it
            source = self._sources[int(key.fields.get("shard", 0))]
            if source.asked_s:
                source.asked_s.popleft()
            source.held = max(1, reply.held)
            lacked_s = max(lacked_s or 0.0, reply.waited_s)
            if batch is not None:
                source.ready.extend(batch.parts(reply.batches))
        for source in self._sources:
            while source.asked_s and now - source.asked_s[0] > ASK_AGAIN_AFTER_S:
                source.asked_s.popleft()
        self._account_waiting(now, lacked_s)

    def _account_waiting(self, now: float, lacked_s: float | None) -> None:
        since_s, starved = self._starved_since_s, not any(source.ready for source in self._sources)
        if since_s is not None and (lacked_s is not None or self._paused):
            self.waiting_data_s += now - since_s
            self.waiting_reply_s += max(0.0, now - since_s - lacked_s) if lacked_s is not None else 0.0
            since_s = None
        if self._paused or not starved:
            self._starved_since_s = None
        else:
            self._starved_since_s = now if since_s is None else since_s

    def _learn(self, now: float) -> int:
        """Learn from ready batches; request others in their place before each update, so that they arrive meanwhile."""
        for done in range(UPDATES_A_STEP):
            full = [source for source in self._sources if source.ready]
            if not full or self._paused:
                self._ask(now)
                return done
            source = min(full, key=lambda source: source.turn)
            batch = source.ready.popleft()
            source.served += 1
            self._ask(now)
            source.learned += 1
            if not self._update(batch, now):
                continue
            if batch.serials is not None:
                priorities = Priorities(self.context.epoch, self.level, batch.serials, self.dqn.errors())
                key = keys.priority(self.context.run, self.level, self._sources.index(source))
                self.transport.publish(key, codec.encode(priorities))
            self._batch_size = len(batch)
        return UPDATES_A_STEP

    def _update(self, batch: Batch, now: float) -> bool:
        """Make an update; return false where it was refused, and the learner went back to its last sound state."""
        try:
            self.dqn.update(batch)
        except UnsoundUpdateError as error:
            self._go_back(self._rollbacks.explain(error, batch, self.updates), now)
            return False
        self.updates += 1
        self._recent_batches.append(batch)
        if (found := self._rollbacks.note_update()) is not None:
            self._go_back(found, now)
        return True

    def _go_back(self, found: str, now: float) -> None:
        """Return to the last sound state and tell watchers why; the run ends where that did not help before."""
        about: dict[str, float | str] = {"level": self.level.value, "update": self.updates, "finished": self._episodes}
        try:
            self._rollbacks.go_back(found, self.updates, self._episodes)
        except RunError:
            self.event(now, "diverged", **about, found=found)
            raise
        self._published_updates = -1  # the networks have changed without an update
        self.event(now, "rolled_back", **about, found=found)

    def _sound(self, what: str, arrays: Callable[[], Parameters], now: float) -> Parameters:
        """Return arrays that others may have; where one is not finite, go back and return those of the sound state."""
        while (wrong := not_finite(what, found := arrays())) is not None:
            self._go_back(wrong, now)
        return found

    def _ask(self, now: float) -> None:
        for index, source in enumerate(self._sources):
            while not self._paused and source.coming + BATCHES_AN_ANSWER <= PREFETCH:
                request = codec.encode(SampleRequest(self.context.epoch, self.level, source.learned, BATCHES_AN_ANSWER))
                key = keys.sample(self.context.run, self.level, index)
                self.transport.request(key, request, self._batches, timeout_s=ANSWER_WITHIN_S)
                source.asked_s.append(now)

    def _publish(self, now: float) -> None:
        fresh = self.updates != self._published_updates and now - self._published_s >= WEIGHTS_EVERY_S
        if fresh or now - self._published_s >= REPEAT_EVERY_S:
            self._publish_weights(now)
        if self._candidates and now - self._offered_s >= REPEAT_EVERY_S:
            self._publish_candidates(now)

    def _publish_weights(self, now: float) -> None:
        if self.updates != self._published_updates:
            self.version, self._made_s = self.version + 1, now
            if self._kept is not None:
                self._kept.note_version(self.version)
        self._published_s, self._published_updates = now, self.updates
        parameters = self._sound("network", self.dqn.parameters, now)
        merge, made_s, weights = self.merge, self._made_s, Weights(self.level, self.version, parameters)

        def publish() -> None:  # a wide network takes a tenth of a second to hash and encode
            message = WeightsMessage(self.context.epoch, merge, network.sha256(parameters), made_s, weights)
            self.transport.publish(keys.weights(self.context.run, self.level), codec.encode(message), retained=True)

        self.in_background(publish)

    def _follow(self, content: LearnerOrders, now: float) -> None:
        index, self._episodes = content.merge, content.finished
        self._paused = not content.learning
        if index > self._offered:
            if content.driven:  # the kept state of a predecessor was damaged
                self.event(now, "candidates_made_again", level=self.level.value, merge=index)
            self._offered = index
            if DISTILLED in content.candidates and not self._recent_batches:  # just resumed: no checkpoint has them
                self.event(now, "distilled_is_recent", level=self.level.value, merge=index)
            self._candidates = self._make_candidates(content.candidates, now)
            self._keep(now)  # first: no successor may offer others under the same names
            self._publish_candidates(now)
        if index > self.merge and content.chosen in self._candidates:
            self._promote(index, content.chosen, now)
        self.finished = content.stop
        if self.finished and self._kept is not None:
            self._kept.discard()

    def _make_candidates(self, names: Sequence[CandidateName], now: float) -> dict[CandidateName, Parameters]:
        makers: dict[CandidateName, Callable[[], Parameters]] = {
            RECENT: self.dqn.parameters,
            DISTILLED: lambda: self._distilled(now),
            BEST: lambda: self._best or self.dqn.parameters(),
        }
        return {name: self._sound(f"candidate {name}", makers[name], now) for name in names}

    def _distilled(self, now: float) -> Parameters:
        """Return the distilled candidate; where its updates are not sound, the recent network in its place."""
        drawn = itertools.islice(itertools.cycle(self._recent_batches), self.config.merge.distil_updates)
        try:
            distilled = self.dqn.distilled(drawn)
            found = not_finite("distilled network", distilled)
        except UnsoundUpdateError as error:
            found = divergence.beyond(error.largest, self.dqn.limit)
        if found is None:
            return distilled
        self.event(now, "distilled_is_recent", level=self.level.value, merge=self._offered, found=found)
        return self.dqn.parameters()

    def _publish_candidates(self, now: float) -> None:
        self._offered_s = now
        for name, parameters in self._candidates.items():
            message = Candidate(self.context.epoch, self.level, self._offered, name, parameters)
            key = keys.candidate(self.context.run, self.level, name)
            self.transport.publish(key, codec.encode(message), retained=True)

    def _promote(self, index: int, chosen: CandidateName, now: float) -> None:
        present = self._sound("network", self.dqn.parameters, now)
        self.dqn.promote(promoted(chosen, self._candidates, present), reset_online=chosen != RECENT)
        self._best = self._candidates[chosen]
        self.merge, self._candidates = index, {}
        self._published_updates = -1  # the networks may have changed without an update
        self._keep(now)  # first: the scheduler goes on once it has heard of it
        self._publish_weights(now)
