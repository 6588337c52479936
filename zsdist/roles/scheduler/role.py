"""The scheduler role: leases episodes, runs the merges, takes checkpoints, and alone writes the run directory."""

from collections import Counter
from enum import StrEnum

from zsdist.dqn.exploration import epsilon
from zsdist.protocol.inbox import Inbox
from zsdist.replay.sizing import AdaptiveSizing, RewardAverages
from zsdist.roles import schemas
from zsdist.roles.base import HEARTBEAT_S, Context, Role
from zsdist.roles.replay import shards
from zsdist.roles.scheduler.leases import Leases
from zsdist.roles.scheduler.merge import BEST, DISTILLED, RECENT, Merge, Phase
from zsdist.roles.scheduler.run_log import RunLog
from zsdist.roles.schemas import Supervision
from zsdist.telemetry.snapshot import Fields, Snapshot
from zsdist.types import Level, Outcome
from zsdist.wire import codec, keys
from zsdist.wire.messages import EPISODES, EVALUATION, Candidate, Jobs, Orders, Records, State, WeightsMessage

ANSWER_WITHIN_S = 10.0


class Stage(StrEnum):
    """Where a run stands, as shown to watchers."""

    TRAIN = "train"
    MERGE = "merge"
    CLOSING = "closing"  # actors flush and close their epochs
    SAVING = "saving"
    DONE = "done"


class Scheduler(Role):
    """Counts finished episodes; exploration and merges follow this one count."""

    def __init__(self, context: Context, ledger: RunLog, restored: State | None = None) -> None:
        super().__init__(context)
        self.ledger = ledger
        self.snapshot = Snapshot()
        self.leases = Leases()
        self.stage = Stage.TRAIN
        self.merge: Merge | None = None
        self.merges: list[dict] = []
        self.outcomes = dict.fromkeys(Outcome, 0)
        self.averages = RewardAverages(context.config.replay.average_episodes)
        self.sizing = AdaptiveSizing(context.config.replay)
        self.env_steps = 0
        self._restarts_before: dict[str, int] = {}  # in earlier sittings, by kind of role
        self._restarts_now: dict[str, int] = {}
        self.recent: list[Outcome] = []  # of the last episodes, for watchers
        self._epochs: dict[str, int] = {}
        self._interrupted = False
        self._inboxes = {stream: Inbox(stream, sender_epoch=context.epoch) for stream in (EPISODES, EVALUATION)}
        self._offered: dict[Level, set[tuple[int, str]]] = {level: set() for level in Level}
        self._merged = dict.fromkeys(Level, 0)
        self._shards = shards.state_names(context.config)
        self._checkpointed = [*self._shards, "learner-high", "learner-low"]
        self._states: dict[str, State] = {}
        self._ask_again_s = 0.0
        self._final_states: dict[str, State] = {}
        self._saved_at = 0  # finished episodes at the last checkpoint
        self._next_orders_s = 0.0
        self._next_metrics_s = 0.0
        if restored is not None:
            self._restore(restored)
        run = context.run
        self._reports = self.mailbox("records")
        self._learners = self.mailbox("weights")
        self._watch = self.mailbox("stats")
        self._answers = self.mailbox("checkpoint")  # of what is asked for in this stage
        self._commands = self.mailbox("commands")
        self.transport.subscribe(keys.episodes(run, keys.ANY, keys.ANY), self._reports)
        self.transport.subscribe(keys.evaluation(run, keys.ANY), self._reports)
        self.transport.subscribe(keys.weights(run, keys.ANY), self._learners, retained=True)
        self.transport.subscribe(keys.candidate(run, keys.ANY, keys.ANY), self._learners, retained=True)
        self.transport.subscribe(keys.stats(run, keys.ANY, keys.ANY), self._watch)
        self.transport.subscribe(keys.control(run, "scheduler"), self._commands, retained=True)

    @property
    def target(self) -> int:
        """Episodes the whole run is to have."""
        return self.config.run.episodes

    def work(self, now: float) -> float:
        """Takes in what happened, decides what follows, and says it."""
        self._obey_supervisor(now)
        self._take_reports(now)
        self._take_offers()
        self.snapshot.take(self._watch.drain())
        self._conduct(now)
        self._speak(now)
        if now >= self._next_metrics_s:
            self._next_metrics_s = now + 1.0
            self.ledger.metrics(self.snapshot.row())
        self.finished = self.stage is Stage.DONE
        return min([self._next_orders_s, *(wake for box in self._inboxes.values() if (wake := box.next_wake(now)))])

    def statistics(self) -> Fields:
        """Progress of the run as a whole."""
        finished = len(self.leases.finished)
        fields: Fields = {
            "stage": self.stage.value,
            "episodes": finished,
            "episodes_target": self.target,
            "env_steps": self.env_steps,
            "epsilon": round(epsilon(finished, self.config.agent.epsilon_decay, self.config.agent.epsilon_min), 4),
            "merges": len(self.merges),
            "restarts": sum(self._restarts().values()),
            "episodes_in_flight": len(self.leases.holders),
            **{outcome.value: count for outcome, count in self.outcomes.items()},
        }
        if self.averages.mean_return is not None:
            fields["mean_return"] = round(self.averages.mean_return, 3)
            fields["average_reward"] = round(self.averages.mean_reward, 4)
        if self.recent:
            fields["recent_success"] = round(self.recent.count(Outcome.SUCCESS) / len(self.recent), 3)
            fields["recent_collision"] = round(self.recent.count(Outcome.COLLISION) / len(self.recent), 3)
        if self.merge is not None:
            fields["drives_left"] = len(self.merge.outstanding())
        return fields

    # -- what comes in ------------------------------------------------------------------------------------------

    def _obey_supervisor(self, now: float) -> None:
        for content in self.orders(self._commands, {Orders: Supervision}):
            for actor, epoch in content.epochs.items():
                if epoch <= self._epochs.get(actor, -1):
                    continue
                if actor in self._epochs:
                    self.leases.give_back(actor)
                    self.event(now, "actor_replaced", actor=actor, actor_epoch=epoch)
                self._epochs[actor] = epoch
                for inbox in self._inboxes.values():
                    inbox.issue(actor, epoch)
                self._next_orders_s = 0.0
            if content.restarts != self._restarts_now:
                self._restarts_now = content.restarts
                self.event(now, "restarted", **self._restarts())
            self._interrupted |= content.interrupted

    def _take_reports(self, now: float) -> None:
        for _, records in self.messages(self._reports, Records, Jobs):
            if isinstance(records, Jobs) or self.checked(schemas.drives, records) is None:
                continue  # its own word to an actor, or one that comes again as it should be
            for frame in self._inboxes[records.stream].receive(records, now):
                for record in frame.records:
                    (self._take_episode if frame.stream == EPISODES else self._take_drive)(frame.actor, record)
                self._next_orders_s = 0.0
        for inbox in self._inboxes.values():
            for ack in inbox.acks(now, lambda actor, epoch: None):
                self.transport.publish(keys.ack(self.context.run, ack.actor), codec.encode(ack))

    def _take_episode(self, actor: str, record: dict) -> None:
        if not self.leases.finish(record["episode"], actor):
            return  # the lease had been given to another
        self.outcomes[Outcome(record["outcome"])] += 1
        self.env_steps += record["steps"]
        self.averages.add_episode(record["return"], record["steps"])
        self.sizing.adjust(len(self.leases.finished), self.averages.mean_return)
        self.recent = [*self.recent[-49:], Outcome(record["outcome"])]
        self.ledger.episode(record | {"finished_as": len(self.leases.finished)})

    def _take_drive(self, actor: str, record: dict) -> None:
        if self.merge is not None and record["merge"] == self.merge.index:
            self.merge.drove(record["candidate"], record["scene_index"], Outcome(record["outcome"]))

    def _take_offers(self) -> None:
        for _, message in self.messages(self._learners, Candidate, WeightsMessage):
            if isinstance(message, Candidate):
                self._offered[message.level].add((message.merge, message.name))
            else:
                self._merged[message.weights.level] = max(self._merged[message.weights.level], message.merge)

    def _restarts(self) -> dict[str, int]:
        """Processes replaced in the whole run, by kind of role; of actors also where it is none."""
        counts = Counter({"actor": 0})
        counts.update(self._restarts_before)
        counts.update(self._restarts_now)
        return dict(counts)

    # -- what follows from it -----------------------------------------------------------------------------------

    def _conduct(self, now: float) -> None:
        """Moves the run on: lease, merge, checkpoint, end."""
        finished = len(self.leases.finished)
        promoting = self.merge is not None and self.merge.phase in (Phase.PROMOTE, Phase.DONE)
        if self._interrupted and self.stage in (Stage.TRAIN, Stage.MERGE) and not promoting:
            self.merge = None
            self._enter(Stage.CLOSING)
        if self.stage is Stage.MERGE:
            self._conduct_merge(now)
        elif self.stage is Stage.TRAIN:
            due = self._merge_barrier() <= finished
            if due:
                self._begin_merge()
            elif finished >= self.target:
                self._enter(Stage.CLOSING)
            else:
                for actor in self._epochs:
                    self.leases.grant(actor, self.config.run.cars_per_actor, min(self._merge_barrier(), self.target))
                if finished - self._saved_at >= self.config.run.checkpoint_every_episodes:
                    self._save(now)
        elif self.stage in (Stage.CLOSING, Stage.SAVING):
            self._conduct_end(now)

    def _merge_barrier(self) -> int:
        """Finished episodes at which the next merge is due: every so many, and at the end where half of them passed.

        0 of `merge.every_episodes` is never.
        """
        every = self.config.merge.every_episodes
        if not every:
            return self.target + 1
        last = self.merges[-1]["episode"] if self.merges else 0
        barrier = (last // every + 1) * every
        return self.target if last + every / 2 <= self.target < barrier else barrier

    def _begin_merge(self) -> None:
        settings = self.config.merge
        names = (RECENT, DISTILLED, BEST) if self.merges else (RECENT, DISTILLED)
        index = len(self.merges) + 1
        self.merge = Merge(
            index, len(self.leases.finished), names, settings.validation_scenes, settings.drop_after_scenes
        )
        self._enter(Stage.MERGE)

    def _conduct_merge(self, now: float) -> None:
        merge = self.merge
        if merge is None:
            return
        before = merge.phase
        offered = [{name for index, name in self._offered[level] if index == merge.index} for level in Level]
        merge.offered(offered)
        if merge.phase is Phase.PROMOTE and all(index >= merge.index for index in self._merged.values()):
            merge.promoted()
        if merge.phase is not before:
            self._next_orders_s = 0.0
        if merge.phase is Phase.DONE and self._save(now):
            self.merges.append(merge.summary())
            self.event(now, "merge", merge=merge.index, chosen=merge.chosen, score=merge.score(merge.chosen))
            over = len(self.leases.finished) >= self.target
            self.merge = None
            self._enter(Stage.CLOSING if over else Stage.TRAIN)

    def _enter(self, stage: Stage) -> None:
        """Says at once what is different now; states asked for before, on their way too, are in no later checkpoint."""
        self.stage, self._next_orders_s = stage, 0.0
        self._answers, self._states, self._ask_again_s = self.mailbox("checkpoint"), {}, 0.0

    def _conduct_end(self, now: float) -> None:
        """Actors close their epochs, the replay confirms that all is stored, then checkpoint and summary."""
        if self.stage is Stage.CLOSING:
            if any(inbox.open_streams() for inbox in self._inboxes.values()):
                return
            self.stage = Stage.SAVING
        if not self._save(now, final=True):
            return
        self.ledger.summary(self._summary())
        self.stage, self._next_orders_s = Stage.DONE, 0.0

    def _save(self, now: float, final: bool = False) -> bool:
        """Asks every stateful role for its state and writes a checkpoint once all have answered; True when written."""
        for _, state in self.messages(self._answers, State):
            if self.checked(schemas.parts, state) is not None:
                self._states[state.role] = state
        for name in self._shards if final else ():
            if name in self._states and any(part["open"] for part in self._states[name].meta.values()):
                del self._states[name]  # frames are still on their way
                self._ask_again_s = now + HEARTBEAT_S
        missing = [name for name in self._checkpointed if name not in self._states]
        if not missing:
            finished = len(self.leases.finished)
            self.ledger.checkpoint(finished, {**self._states, "scheduler": self.state()})
            self._final_states, self._states = self._states, {}
            self._ask_again_s, self._saved_at = 0.0, finished
            return True
        if now >= self._ask_again_s:
            self._ask_again_s = now + ANSWER_WITHIN_S
            for name in missing:
                ask = codec.encode(Orders(self.context.epoch, name, {"ask": "state"}))
                key = keys.control(self.context.run, name)
                self.transport.request(key, ask, self._answers, timeout_s=ANSWER_WITHIN_S)
        return False

    # -- what goes out ------------------------------------------------------------------------------------------

    def _speak(self, now: float) -> None:
        """Says every absolute state again when it changed or a heartbeat is due."""
        if now < self._next_orders_s:
            return
        self._next_orders_s = now + HEARTBEAT_S
        run, epoch = self.context.run, self.context.epoch
        for role, content in self._orders().items():
            payload = codec.encode(Orders(epoch, role, content))
            self.transport.publish(keys.control(run, role), payload, retained=True)
        for actor, drives in self._drives().items():
            content = {"merge": self.merge.index if self.merge else 0, "drives": drives}
            payload = codec.encode(Jobs(epoch, actor, content))
            self.transport.publish(keys.evaluation(run, actor), payload, retained=True)

    def _orders(self) -> dict[str, dict]:
        finished = len(self.leases.finished)
        merge = self.merge
        done = self.stage is Stage.DONE
        ending = self.stage in (Stage.CLOSING, Stage.SAVING, Stage.DONE)
        return {
            "actor": {
                "epochs": self._epochs,
                "leases": {actor: self.leases.of(actor) for actor in self._epochs},
                "finished": finished,
                "merge": merge.index if merge else len(self.merges) + 1,
                "closing": ending,
                "cut": ending and self._interrupted,
            },
            shards.ROLE: {
                "epochs": self._epochs,
                "buffer_size": self.sizing.size,
                "batch_size": self.sizing.batch_size,
                "stop": done,
            },
            "learner": {
                # Not while candidates are compared, nor after the last comparison.
                "learning": self.stage is Stage.TRAIN,
                "merge": merge.index if merge else 0,
                "phase": merge.phase.value if merge else "",
                "candidates": list(merge.candidates) if merge else [],
                "chosen": merge.chosen if merge else "",
                "stop": done,
            },
        }

    def _drives(self) -> dict[str, list[list]]:
        """Outstanding drives dealt to the actors in turn; the same drive to the same actor each time."""
        drives: dict[str, list[list]] = {actor: [] for actor in sorted(self._epochs)}
        actors = list(drives)
        for name, scene in self.merge.outstanding() if self.merge else []:
            drives[actors[(scene + self.merge.candidates.index(name)) % len(actors)]].append([name, scene])
        return drives

    # -- state --------------------------------------------------------------------------------------------------

    def state(self) -> State:
        """Everything the next process needs to go on counting."""
        merges = [*self.merges, *([self.merge.summary()] if self.merge is not None else [])]
        meta = {
            "finished": sorted(self.leases.finished),
            "outcomes": {outcome.value: count for outcome, count in self.outcomes.items()},
            "averages": self.averages.state(),
            "sizing": self.sizing.state(),
            "recent": [outcome.value for outcome in self.recent],
            "env_steps": self.env_steps,
            "merges": merges,
            "restarts": self._restarts(),
            "max_lag_versions": self.snapshot.max_lag_versions,
            "max_lag_s": self.snapshot.max_lag_s,
            "wall_s": self.ledger.wall_s(),
        }
        return State("scheduler", meta, {})

    def _restore(self, state: State) -> None:
        meta = state.meta
        self.averages.restore(meta["averages"])
        self.sizing.restore(meta["sizing"])
        self.recent = [Outcome(name) for name in meta["recent"]]
        self.leases = Leases(meta["finished"])
        self.outcomes = {Outcome(name): count for name, count in meta["outcomes"].items()}
        self.env_steps = meta["env_steps"]
        self.merges, self._restarts_before = list(meta["merges"]), meta["restarts"]
        self.snapshot.max_lag_versions, self.snapshot.max_lag_s = meta["max_lag_versions"], meta["max_lag_s"]
        self._saved_at = len(self.leases.finished)

    def _summary(self) -> dict:
        learners = {level: self._final_states[f"learner-{level}"].meta for level in Level}
        books = {level.value: Counter() for level in Level}
        for name in self._shards:
            for level, counts in books.items():
                counts.update(self._final_states[name].meta[level]["books"])
        wall_s = self.ledger.wall_s()
        return {
            "episodes": len(self.leases.finished),
            "ended": "interrupted" if self._interrupted else "complete",
            "env_steps": self.env_steps,
            "learner_updates": {level.value: meta["updates"] for level, meta in learners.items()},
            "transitions": {level: dict(counts) for level, counts in books.items()},
            "weights": {
                "version": {level.value: meta["version"] for level, meta in learners.items()},
                "max_lag_versions": self.snapshot.max_lag_versions,
                "max_lag_s": self.snapshot.max_lag_s,
                "sha256": {level.value: meta["sha256"] for level, meta in learners.items()},
            },
            "merges": self.merges,
            "outcomes": {outcome.value: count for outcome, count in self.outcomes.items()},
            "rates": {
                "env_steps_per_s": round(self.env_steps / max(wall_s, 1e-9), 2),
                "episodes_per_min": round(60 * len(self.leases.finished) / max(wall_s, 1e-9), 2),
            },
            "restarts": self._restarts(),
            "wall_s": wall_s,
        }
