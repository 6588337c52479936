"""Scheduler role: leases episodes, conducts merges and checkpoints, and alone writes the run directory."""

from pathlib import Path
from typing import Any

from zsdist.dqn.exploration import epsilon
from zsdist.roles.base import HEARTBEAT_S, Context, Role
from zsdist.roles.replay import shards
from zsdist.roles.scheduler.job_book import JobBook
from zsdist.roles.scheduler.ledger import Ledger
from zsdist.roles.scheduler.members import Members
from zsdist.roles.scheduler.merge import NO_MERGE, Drive, Merge
from zsdist.roles.scheduler.merge_plan import MergePlan
from zsdist.roles.scheduler.progress import RunProgress, Stage
from zsdist.roles.scheduler.run_log import RunLog
from zsdist.roles.scheduler.saving import Saving
from zsdist.roles.scheduler.standstill import StandstillWatch
from zsdist.roles.scheduler.summary import run_summary
from zsdist.roles.schemas import Supervision
from zsdist.telemetry.snapshot import Fields, Snapshot
from zsdist.types import Level
from zsdist.wire import codec, keys
from zsdist.wire.messages import Jobs, Orders, Records, State, WeightsMessage


class Scheduler(Role):
    """Scheduler of a run. Exploration and merges follow its count of finished episodes alone.

    Args:
        context: identity of the role.
        run_log: files that it writes.
        folder: folder of the ledger, shared with this scheduler's predecessors in this start of the run.
        restored: state in a checkpoint; used only if there is no ledger yet.
    """

    def __init__(self, context: Context, run_log: RunLog, folder: Path, restored: State | None = None) -> None:
        super().__init__(context)
        self.run_log = run_log
        self.snapshot = Snapshot()
        self.progress = RunProgress(context.config, context.epoch, self.refuse)
        self.ledger = Ledger(folder, context.epoch)
        self._plan = MergePlan(context.config, self.progress)
        self._members = Members(context.config.run.actors)
        self._jobs = JobBook(context.epoch, self.progress)
        self._drives: dict[str, list[Drive]] = {}  # of each actor, as they were last dealt
        self._advanced = False  # whether drives have ended since then
        self._merged = dict.fromkeys(Level, 0)  # index of the last merge that each learner has taken over
        self._sits, self._last = False, self.target  # whether all roles close before the run's end; episodes until then
        self._saving = Saving(self)
        self._final_states: dict[str, State] | None = None  # in the last checkpoint of the run
        self._now_s = self._next_orders_s = self._next_metrics_s = 0.0
        self._standstill = StandstillWatch()
        self._begins_as = self._recover(restored)
        run = context.run
        self._reports = self.mailbox("records")
        self._learners = self.mailbox("weights")
        self._watch = self.mailbox("stats")
        self._commands = self.mailbox("commands")
        self.transport.subscribe(keys.episodes(run, keys.ANY, keys.ANY), self._reports)
        self.transport.subscribe(keys.evaluation(run, keys.ANY), self._reports)
        self.transport.subscribe(keys.weights(run, keys.ANY), self._learners, retained=True)
        self.transport.subscribe(keys.stats(run, keys.ANY, keys.ANY), self._watch)
        self.transport.subscribe(keys.control(run, "scheduler"), self._commands, retained=True)

    @property
    def stage(self) -> Stage:
        """Present stage of the run."""
        return self.progress.stage

    @property
    def target(self) -> int:
        """Number of episodes of the whole run."""
        return self.config.run.episodes

    @property
    def finished_episodes(self) -> int:
        """Count of finished episodes."""
        return self.progress.finished

    def work(self, now: float) -> float:
        """Receive what has arrived, decide what follows, write it into the ledger, and publish it."""
        self._now_s = now
        self.ledger.require_newest()
        if self._begins_as:
            self.event(now, self._begins_as, stage=self.stage.value, finished=self.finished_episodes)
            self._begins_as = ""
        self._follow_supervisor(now)
        self._receive_records(now)
        self._receive_promotions()
        self.snapshot.update(self._watch.drain())
        if now >= self._next_metrics_s and self.snapshot.of("scheduler"):
            self._next_metrics_s = now + 1.0
            self.snapshot.keep_actors(self.progress.epochs)
            self._note_figures()
            self.run_log.metrics(self.snapshot.row())
            self._standstill.watch(now, self.snapshot, self.event)
        self._conduct(now)
        self.ledger.append(self.progress.take_entries())
        if self.ledger.wants_base:
            self.ledger.rebase(self.progress.base())
        self._publish(now)
        self.finished, inboxes = self.stage is Stage.DONE, self.progress.inboxes.values()
        return min([self._next_orders_s, *(wake for box in inboxes if (wake := box.next_wake(now)))])

    def statistics(self) -> Fields:
        """Return the progress of the run as a whole."""
        finished, agent, totals = self.finished_episodes, self.config.agent, self.progress.totals
        goes_on = self._sits and (finished < self.target or self._plan.next_merge <= finished)  # more sittings follow
        fields: Fields = {
            "stage": (Stage.TRAIN if goes_on else self.stage).value,
            "episodes": finished,
            "episodes_target": self.target,
            "env_steps": totals.env_steps,
            "epsilon": round(epsilon(finished, agent.epsilon_decay, agent.epsilon_min), 4),
            "merges": len(totals.merges),
            "restarts": sum(totals.restarts().values()),
            "episodes_in_flight": len(self.progress.leases.holders),
            "ledger_bytes": self.ledger.nbytes,
            **{outcome.value: count for outcome, count in totals.outcomes.items()},
            **totals.statistics(),
            **self._saving.statistics(),
        }
        merge = self.progress.merge
        return fields if merge is None else fields | {"drives_left": len(merge.outstanding())}

    # -- input --------------------------------------------------------------------------------------------------

    def _follow_supervisor(self, now: float) -> None:
        for content in self.orders(self._commands, {Orders: Supervision}):
            admits = self.stage is Stage.TRAIN
            for event, actor, epoch in self._members.changes(content, self.progress.epochs, admits=admits):
                (self.progress.dismiss if event == "actor_left" else self.progress.issue)(actor, epoch)
                if event:
                    self.event(now, event, actor=actor, actor_epoch=epoch)
                self._next_orders_s = 0.0
            if self.progress.totals.set_restarts(content.restarts):
                self.event(now, "restarted", **self.progress.totals.restarts())
            self.progress.interrupted |= content.interrupted
            if content.until is not None:
                self._sits, self._last = True, min(content.until, self.target)

    def _receive_records(self, now: float) -> None:
        lines, sizing, driven = [], self.progress.totals.sizing, self._plan.driven
        before = (sizing.size, sizing.batch_size, self.progress.promotes)
        for message, records in self.messages(self._reports, Records, own=Jobs):
            lines += self.progress.receive(records, message.payload, now)
        self._advanced |= driven != self._plan.driven
        if before != (sizing.size, sizing.batch_size, self.progress.promotes):
            self._next_orders_s = 0.0
        self.ledger.append(self.progress.take_entries())
        for line in lines:
            self.run_log.episode(line)
        for inbox in self.progress.inboxes.values():
            for ack in inbox.acks(now, lambda actor, epoch: None):
                self.transport.publish(keys.ack(self.context.run, ack.actor), codec.encode(ack))

    def _receive_promotions(self) -> None:
        for level, message in self.learner_news(self._learners):
            if isinstance(message, WeightsMessage):
                self._merged[level] = max(self._merged[level], message.merge)

    # -- decisions ----------------------------------------------------------------------------------------------

    def _conduct(self, now: float) -> None:
        """Advance the run: leases, merge, checkpoint, end."""
        if self.progress.merge is not None:
            self._conduct_merge(self.progress.merge, now)
        if self.stage is Stage.TRAIN:
            self._conduct_training(now)
        elif self.stage in (Stage.CLOSING, Stage.SAVING):
            self._conduct_end(now)

    def _conduct_training(self, now: float) -> None:
        progress, finished = self.progress, self.finished_episodes
        if progress.interrupted:
            if not progress.promotes:
                progress.merge = None
                self._enter(Stage.CLOSING)
            return
        if progress.merge is None and (due := self._plan.next_merge) <= finished:
            progress.begin_merge(due, now)
            self._next_orders_s = 0.0
        if progress.merge is None and finished >= self._last:
            self._enter(Stage.CLOSING)
            return
        progress.grant(self._barrier, evenly=self._sits)
        if not self._sits and not progress.promotes and progress.schedule.is_due(finished, now):
            self._save(now)

    @property
    def _barrier(self) -> int:
        """Number of episodes that are finished or granted in all, at most."""
        return min(self._plan.training_ends, self._last)

    def _conduct_merge(self, merge: Merge, now: float) -> None:
        """End a merge once both learners have taken over its winner.

        No checkpoint is made meanwhile, and no later one contains states that were requested before.
        """
        if merge.began_s is None:  # it has begun again under another runner
            merge.began_s = now
        if merge.chosen is None or any(index < merge.index for index in self._merged.values()):
            return
        self.progress.end_merge(round(max(0.0, now - merge.began_s), 3))
        self.event(now, "merge", merge=merge.index, chosen=merge.chosen, score=merge.score(merge.chosen))
        self._saving.restart()
        self._next_orders_s = 0.0
        if not self._sits:  # a sitting saves at its end
            self.progress.schedule.demand()

    def _enter(self, stage: Stage) -> None:
        """Begin a stage, and publish it at once.

        No later checkpoint contains states that were requested before, even if they are still on their way.
        """
        self.progress.stage, self._next_orders_s = stage, 0.0
        self._saving.restart()

    def _conduct_end(self, now: float) -> None:
        """End the run: actors close their epochs, the replay stores everything, then checkpoint and summary follow."""
        if self.stage is Stage.CLOSING:
            if not all(inbox.closed for inbox in self.progress.inboxes.values()):
                return
            self.progress.stage = Stage.SAVING
        if self._final_states is None:
            self._save(now, final=True)
        if self._final_states is None or not self._saving.has_written:
            return
        if not self._sits:
            about = (self.progress.totals, self._final_states, self.snapshot)
            finished, interrupted, wall_s = self.finished_episodes, self.progress.interrupted, self.progress.wall_s
            self.run_log.summary(run_summary(*about, finished=finished, interrupted=interrupted, wall_s=wall_s))
        self.progress.stage, self._next_orders_s = Stage.DONE, 0.0

    def _save(self, now: float, final: bool = False) -> None:
        """Request the states of all roles, and once all have answered begin to write a checkpoint, one at a time."""
        if not self._saving.has_written or (answers := self._saving.collect(now, delivered=final)) is None:
            return
        states = {name: answer.payload for name, answer in answers.items()} | {"scheduler": codec.encode(self.state())}
        self._saving.write(self.run_log.begin_checkpoint(self.finished_episodes, states, self.progress.totals.score))
        self.progress.schedule.note_checkpoint(self.finished_episodes, now)
        if final:
            self._final_states = {name: answer.state for name, answer in answers.items()}

    # -- output -------------------------------------------------------------------------------------------------

    def _publish(self, now: float) -> None:
        """Publish the absolute state of all orders and jobs at each heartbeat, and jobs in between where they change.

        An episode that ends concerns one actor: what is sent for it does not grow with the number of actors.
        """
        progress, run = self.progress, self.context.run
        changed, heartbeat = progress.leases.take_changed(), now >= self._next_orders_s
        if heartbeat:
            self._next_orders_s = now + HEARTBEAT_S
            for role, orders in self._orders().items():
                payload = codec.encode(Orders(self.context.epoch, role, orders))
                self.transport.publish(keys.control(run, role), payload, retained=True)
        if heartbeat or self._advanced:
            self._drives = progress.drives() if progress.merge is not None else {}
        deals = heartbeat or (self._advanced and bool(self._drives))
        actors = [*progress.epochs, *self._members.left] if deals else sorted(changed)
        renewed = self._jobs.renew(actors, self._drives)
        for actor, payload in self._jobs.payloads(actors) if heartbeat else renewed:
            self.transport.publish(keys.evaluation(run, actor), payload, retained=True)
        self._advanced = False

    def _orders(self) -> dict[str, dict[str, Any]]:
        progress, merge = self.progress, self.progress.merge
        done = self.stage is Stage.DONE
        ending = self.stage in (Stage.CLOSING, Stage.SAVING, Stage.DONE)
        return {
            "actor": {
                "leasing": self.stage is Stage.TRAIN and progress.leases.left(self._barrier) > 0,
                "finished": self.finished_episodes,
                "merge": merge.index if merge else progress.merge_index + 1,
                "closing": ending,
                "cut": ending and progress.interrupted,
            },
            shards.ROLE: {
                "epochs": progress.epochs,
                "left": self._members.left,
                "buffer_size": progress.totals.sizing.size,
                "batch_size": progress.totals.sizing.batch_size,
                "stop": done,
            },
            "learner": {
                # The last comparison is of the networks with which the run ends.
                "learning": self.stage is Stage.TRAIN and self.finished_episodes < self.target,
                "finished": self.finished_episodes,
                **(merge.orders() if merge else NO_MERGE),
                "stop": done,
            },
        }

    # -- state --------------------------------------------------------------------------------------------------

    def state(self) -> State:
        """Return all that the next start of the run needs to resume."""
        self._note_figures()
        return State("scheduler", self.progress.state() | {"time_s": round(self._now_s, 3)}, {})

    def _recover(self, restored: State | None) -> str:
        """Go on from the ledger; where there is none, begin one, from a checkpoint's `state` or from nothing.

        Returns the name of the event that tells watchers; empty where there was no ledger.
        """
        found = self.ledger.recover()
        if found is not None:
            for line in self.progress.recover(found):
                self.run_log.episode(line)
        elif restored is not None:
            self.progress.restore(restored.meta)
        is_another_launch = self.progress.begin_launch(self.context.launch)
        self.ledger.rebase(self.progress.base())
        self.snapshot.max_lag_versions = self.progress.max_lag_versions
        self.snapshot.max_lag_s = self.progress.max_lag_s
        self._earlier_s = self.progress.wall_s - self.run_log.wall_s()
        return "" if found is None else "resumed" if is_another_launch else "scheduler_replaced"

    def _note_figures(self) -> None:
        """Note the figures that change with time alone."""
        self.progress.max_lag_versions = self.snapshot.max_lag_versions
        self.progress.max_lag_s = self.snapshot.max_lag_s
        self.progress.wall_s = round(self._earlier_s + self.run_log.wall_s(), 3)
