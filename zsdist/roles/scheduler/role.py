"""Scheduler role: leases episodes, conducts merges and checkpoints, and alone writes the run directory."""

from enum import StrEnum
from typing import Any

from zsdist.dqn.exploration import epsilon
from zsdist.roles import schemas
from zsdist.roles.base import HEARTBEAT_S, Context, Role
from zsdist.roles.replay import shards
from zsdist.roles.scheduler.checkpointing import ANSWER_WITHIN_S, CheckpointSchedule, StateCollection
from zsdist.roles.scheduler.leases import Leases
from zsdist.roles.scheduler.merge import NO_MERGE, Drive, Merge, deal_drives, next_merge_at
from zsdist.roles.scheduler.records_inbox import RecordsInbox
from zsdist.roles.scheduler.run_log import RunLog
from zsdist.roles.scheduler.standstill import StandstillWatch
from zsdist.roles.scheduler.summary import run_summary
from zsdist.roles.scheduler.totals import RunTotals
from zsdist.roles.schemas import BEST, DISTILLED, RECENT, Phase, Supervision
from zsdist.telemetry.snapshot import Fields, Snapshot
from zsdist.types import Level, Outcome
from zsdist.wire import codec, keys
from zsdist.wire.messages import EPISODES, EVALUATION, Candidate, Jobs, Orders, Records, State


class Stage(StrEnum):
    """Stage of a run, as shown to watchers."""

    TRAIN = "train"
    MERGE = "merge"
    CLOSING = "closing"  # actors flush and close their epochs
    SAVING = "saving"
    DONE = "done"


class Scheduler(Role):
    """Scheduler of a run. Exploration and merges follow its count of finished episodes alone."""

    def __init__(self, context: Context, run_log: RunLog, restored: State | None = None) -> None:
        super().__init__(context)
        self.run_log = run_log
        self.snapshot = Snapshot()
        self.totals = RunTotals(context.config)
        self.leases = Leases()
        self.stage = Stage.TRAIN
        self.merge: Merge | None = None
        self._epochs: dict[str, int] = {}  # newest epoch of each actor
        self._interrupted = False
        self._inboxes = {stream: RecordsInbox(stream, context.epoch, self.refuse) for stream in (EPISODES, EVALUATION)}
        self._offered: dict[Level, dict[str, int]] = {level: {} for level in Level}  # candidate -> its newest merge
        self._merged = dict.fromkeys(Level, 0)  # index of the last merge that each learner has taken over
        self._collection = StateCollection(context.config)
        self._final_states: dict[str, State] = {}
        self._schedule = CheckpointSchedule(context.config.run)
        self._next_orders_s = self._next_metrics_s = 0.0
        self._standstill = StandstillWatch()
        if restored is not None:
            self._restore(restored.meta)
        run = context.run
        self._reports = self.mailbox("records")
        self._learners = self.mailbox("weights")
        self._watch = self.mailbox("stats")
        self._answers = self.mailbox("checkpoint")  # to the requests of this stage
        self._commands = self.mailbox("commands")
        self.transport.subscribe(keys.episodes(run, keys.ANY, keys.ANY), self._reports)
        self.transport.subscribe(keys.evaluation(run, keys.ANY), self._reports)
        self.transport.subscribe(keys.weights(run, keys.ANY), self._learners, retained=True)
        self.transport.subscribe(keys.candidate(run, keys.ANY, keys.ANY), self._learners, retained=True)
        self.transport.subscribe(keys.stats(run, keys.ANY, keys.ANY), self._watch)
        self.transport.subscribe(keys.control(run, "scheduler"), self._commands, retained=True)

    @property
    def target(self) -> int:
        """Number of episodes of the whole run."""
        return self.config.run.episodes

    @property
    def finished_episodes(self) -> int:
        """Count of finished episodes."""
        return self.leases.finished_count

    def work(self, now: float) -> float:
        """Receive what has arrived, decide what follows, and publish it."""
        self._follow_supervisor(now)
        self._receive_records(now)
        self._receive_offers()
        self.snapshot.update(self._watch.drain())
        self._conduct(now)
        self._publish(now)
        if now >= self._next_metrics_s:
            self._next_metrics_s = now + 1.0
            self.run_log.metrics(self.snapshot.row())
            self._standstill.watch(now, self.snapshot, self.event)
        self.finished = self.stage is Stage.DONE
        return min([self._next_orders_s, *(wake for box in self._inboxes.values() if (wake := box.next_wake(now)))])

    def statistics(self) -> Fields:
        """Return the progress of the run as a whole."""
        finished, agent = self.finished_episodes, self.config.agent
        fields: Fields = {
            "stage": self.stage.value,
            "episodes": finished,
            "episodes_target": self.target,
            "env_steps": self.totals.env_steps,
            "epsilon": round(epsilon(finished, agent.epsilon_decay, agent.epsilon_min), 4),
            "merges": len(self.totals.merges),
            "restarts": sum(self.totals.restarts().values()),
            "episodes_in_flight": len(self.leases.holders),
            **{outcome.value: count for outcome, count in self.totals.outcomes.items()},
            **self.totals.statistics(),
            **self._collection.statistics(),
        }
        if self.merge is not None:
            fields["drives_left"] = len(self.merge.outstanding())
        return fields

    # -- input --------------------------------------------------------------------------------------------------

    def _follow_supervisor(self, now: float) -> None:
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
            if self.totals.set_restarts(content.restarts):
                self.event(now, "restarted", **self.totals.restarts())
            self._interrupted |= content.interrupted

    def _receive_records(self, now: float) -> None:
        for _, records in self.messages(self._reports, Records, Jobs):
            if isinstance(records, Jobs):
                continue  # this role's own
            for frame in self._inboxes[records.stream].receive(records, now):
                for record in frame.records:
                    if frame.stream == EPISODES:
                        self._add_episode(frame.actor, record)
                    else:
                        self._add_drive(record)
                self._next_orders_s = 0.0
        for inbox in self._inboxes.values():
            for ack in inbox.acks(now, lambda actor, epoch: None):
                self.transport.publish(keys.ack(self.context.run, ack.actor), codec.encode(ack))

    def _add_episode(self, actor: str, record: dict[str, Any]) -> None:
        if not self.leases.finish(record["episode"], actor):
            return  # the lease has been granted to another actor since
        self.totals.add_episode(record, self.finished_episodes)
        self.run_log.episode(record | {"finished_as": self.finished_episodes})

    def _add_drive(self, record: dict[str, Any]) -> None:
        if self.merge is not None and record["merge"] == self.merge.index:
            self.merge.add_result(record["candidate"], record["scene_index"], Outcome(record["outcome"]))

    def _receive_offers(self) -> None:
        for level, message in self.learner_news(self._learners):
            if isinstance(message, Candidate):
                self._offered[level][message.name] = message.merge
            else:
                self._merged[level] = max(self._merged[level], message.merge)

    # -- decisions ----------------------------------------------------------------------------------------------

    def _conduct(self, now: float) -> None:
        """Advance the run: leases, merge, checkpoint, end."""
        promoting = self.merge is not None and self.merge.phase in (Phase.PROMOTE, Phase.DONE)
        if self._interrupted and self.stage in (Stage.TRAIN, Stage.MERGE) and not promoting:
            self.merge = None
            self._enter(Stage.CLOSING)
        if self.merge is not None:
            self._conduct_merge(self.merge, now)
        elif self.stage is Stage.TRAIN:
            self._conduct_training(now)
        elif self.stage in (Stage.CLOSING, Stage.SAVING):
            self._conduct_end(now)

    def _conduct_training(self, now: float) -> None:
        finished = self.finished_episodes
        last = self.totals.merges[-1]["episode"] if self.totals.merges else 0
        barrier = next_merge_at(last, self.config.merge.every_episodes, self.target)
        if barrier <= finished:
            self._begin_merge()
        elif finished >= self.target:
            self._enter(Stage.CLOSING)
        else:
            for actor in self._epochs:
                self.leases.grant(actor, self.config.run.cars_per_actor, min(barrier, self.target))
            if self._schedule.is_due(finished, now):
                self._save(now)

    def _begin_merge(self) -> None:
        settings = self.config.merge
        self.merge = Merge(
            index=len(self.totals.merges) + 1,
            episode=self.finished_episodes,
            candidates=(RECENT, DISTILLED, BEST) if self.totals.merges else (RECENT, DISTILLED),
            scenes=settings.validation_scenes,
            drop_after=settings.drop_after_scenes,
        )
        self._enter(Stage.MERGE)

    def _conduct_merge(self, merge: Merge, now: float) -> None:
        before = merge.phase
        offers = self._offered.values()
        merge.start_drives([{name for name, index in names.items() if index == merge.index} for names in offers])
        if merge.phase is Phase.PROMOTE and all(index >= merge.index for index in self._merged.values()):
            merge.finish()
        if merge.phase is not before:
            self._next_orders_s = 0.0
        if merge.phase is Phase.DONE and self._save(now):
            self.totals.merges.append(merge.summary())
            assert merge.chosen is not None  # else the phase is DRIVE still
            self.event(now, "merge", merge=merge.index, chosen=merge.chosen, score=merge.score(merge.chosen))
            self.merge = None
            self._enter(Stage.CLOSING if self.finished_episodes >= self.target else Stage.TRAIN)

    def _enter(self, stage: Stage) -> None:
        """Begin a stage, and publish it at once.

        No later checkpoint contains states that were requested before, even if they are still on their way.
        """
        self.stage, self._next_orders_s = stage, 0.0
        self._answers = self.mailbox("checkpoint")
        self._collection.clear()

    def _conduct_end(self, now: float) -> None:
        """End the run: actors close their epochs, the replay stores everything, then checkpoint and summary follow."""
        if self.stage is Stage.CLOSING:
            if any(inbox.open_streams() for inbox in self._inboxes.values()):
                return
            self.stage = Stage.SAVING
        if not self._save(now, final=True):
            return
        summary = run_summary(
            self.totals,
            self._final_states,
            self.snapshot,
            finished=self.finished_episodes,
            interrupted=self._interrupted,
            wall_s=self.run_log.wall_s(),
        )
        self.run_log.summary(summary)
        self.stage, self._next_orders_s = Stage.DONE, 0.0

    def _save(self, now: float, final: bool = False) -> bool:
        """Request the states of all roles, and write a checkpoint once all have answered; return whether it did."""
        for _, state in self.messages(self._answers, State):
            if self.checked(schemas.check_state, state) is not None:
                self._collection.accept(state)
        if final:
            self._collection.drop_open(now)
        states = self._collection.take()
        if states is not None:
            self.run_log.checkpoint(self.finished_episodes, {**states, "scheduler": self.state()})
            self._schedule.note_checkpoint(self.finished_episodes, now)
            self._final_states = states
            return True
        for name in self._collection.due(now):
            request = codec.encode(Orders(self.context.epoch, name, {"ask": "state", "epoch": self.newest_epoch(name)}))
            where = keys.control(self.context.run, name)
            self.transport.request(where, request, self._answers, timeout_s=ANSWER_WITHIN_S)
        return False

    # -- output -------------------------------------------------------------------------------------------------

    def _publish(self, now: float) -> None:
        """Publish the absolute state of all orders and jobs where it changed or a heartbeat is due."""
        if now < self._next_orders_s:
            return
        self._next_orders_s = now + HEARTBEAT_S
        run, epoch = self.context.run, self.context.epoch
        for role, orders in self._orders().items():
            payload = codec.encode(Orders(epoch, role, orders))
            self.transport.publish(keys.control(run, role), payload, retained=True)
        for actor, drives in self._drives().items():
            jobs = {"merge": self.merge.index if self.merge else 0, "drives": [list(drive) for drive in drives]}
            payload = codec.encode(Jobs(epoch, actor, jobs))
            self.transport.publish(keys.evaluation(run, actor), payload, retained=True)

    def _orders(self) -> dict[str, dict[str, Any]]:
        merge = self.merge
        done = self.stage is Stage.DONE
        ending = self.stage in (Stage.CLOSING, Stage.SAVING, Stage.DONE)
        return {
            "actor": {
                "epochs": self._epochs,
                "leases": {actor: self.leases.held_by(actor) for actor in self._epochs},
                "finished": self.finished_episodes,
                "merge": merge.index if merge else len(self.totals.merges) + 1,
                "closing": ending,
                "cut": ending and self._interrupted,
            },
            shards.ROLE: {
                "epochs": self._epochs,
                "buffer_size": self.totals.sizing.size,
                "batch_size": self.totals.sizing.batch_size,
                "stop": done,
            },
            "learner": {
                # Not while candidates are compared, nor after the last comparison.
                "learning": self.stage is Stage.TRAIN,
                "finished": self.finished_episodes,
                **(merge.orders() if merge else NO_MERGE),
                "stop": done,
            },
        }

    def _drives(self) -> dict[str, list[Drive]]:
        outstanding, candidates = (self.merge.outstanding(), self.merge.candidates) if self.merge else ([], ())
        return deal_drives(outstanding, candidates, sorted(self._epochs))

    # -- state --------------------------------------------------------------------------------------------------

    def state(self) -> State:
        """Return all that the next start of the run needs to resume."""
        merges = [*self.totals.merges, *([self.merge.summary()] if self.merge is not None else [])]
        meta = {
            "finished": sorted(self.leases.finished),
            **self.totals.state(merges),
            "max_lag_versions": self.snapshot.max_lag_versions,
            "max_lag_s": self.snapshot.max_lag_s,
            "wall_s": self.run_log.wall_s(),
        }
        return State("scheduler", meta, {})

    def _restore(self, meta: dict[str, Any]) -> None:
        self.totals.restore(meta)
        self.leases = Leases(meta["finished"])
        self.snapshot.max_lag_versions, self.snapshot.max_lag_s = meta["max_lag_versions"], meta["max_lag_s"]
        self._schedule.note_checkpoint(self.finished_episodes)
