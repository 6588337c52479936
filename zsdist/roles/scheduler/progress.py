"""Progress of a run as its scheduler knows it, as a state machine without messages or files.

Every change is noted as an entry of the ledger. The successor of a scheduler that died makes the same changes in the
same order, by the same methods, and so knows what its predecessor knew.
"""

import json
from collections.abc import Callable
from enum import StrEnum
from typing import Any

from zsdist.config import Config
from zsdist.replay.journal import Record
from zsdist.roles.scheduler.checkpointing import CheckpointSchedule
from zsdist.roles.scheduler.drive_deal import DriveDeal
from zsdist.roles.scheduler.lease_queue import LeaseQueue
from zsdist.roles.scheduler.leases import Leases
from zsdist.roles.scheduler.ledger import LedgerContent, LedgerEntry
from zsdist.roles.scheduler.merge import Drive, Merge
from zsdist.roles.scheduler.records_inbox import RecordsInbox
from zsdist.roles.scheduler.totals import RunTotals
from zsdist.roles.schemas import BEST, DISTILLED, RECENT
from zsdist.types import Outcome
from zsdist.wire import codec
from zsdist.wire.messages import EPISODES, EVALUATION, Records

Line = dict[str, Any]  # line of `episodes.jsonl`


class Stage(StrEnum):
    """Stage of a run, as shown to watchers."""

    TRAIN = "train"  # with its merges
    CLOSING = "closing"  # actors flush and close their epochs
    SAVING = "saving"
    DONE = "done"


class RunProgress:
    """Progress of a run.

    Args:
        config: configuration of the run.
        sender_epoch: incarnation of the scheduler.
        refuse: function that counts a refused frame by its reason.

    Attributes:
        totals: totals of the run.
        leases: episodes that are finished, and those that actors drive.
        stage: present stage; a change of it is noted like one of any other attribute.
        merge: merge under way, beside training; None: there is none.
        merge_index: index of the last merge that was begun.
        interrupted: whether the run was told to stop early.
        epochs: newest epoch of each actor.
        inboxes: receivers of the actors' records by stream.
        schedule: decision when the next checkpoint is due.
        max_lag_versions, max_lag_s: as in `zsdist.telemetry.snapshot.Snapshot`.
        wall_s: real seconds that the run has taken, as far as was noted.
        launch: epoch of the runner.
        entries: what has changed and is not in the ledger yet, but for the attributes that `status` returns.
    """

    def __init__(self, config: Config, sender_epoch: int, refuse: Callable[[str], None]) -> None:
        self._config = config
        self.totals = RunTotals(config)
        self.leases = Leases()
        self.stage = Stage.TRAIN
        self.merge: Merge | None = None
        self.merge_index = 0
        self.interrupted = False
        self.epochs: dict[str, int] = {}
        self.inboxes = {stream: RecordsInbox(stream, sender_epoch, refuse) for stream in (EPISODES, EVALUATION)}
        self.schedule = CheckpointSchedule(config.run)
        self.max_lag_versions, self.max_lag_s = 0, 0.0
        self.wall_s = 0.0
        self.launch = 0
        self.entries: list[Record] = []
        self._deal = DriveDeal(config.run.cars_per_actor)
        self._queue = LeaseQueue(config.run.cars_per_actor)
        self._noted: dict[str, Any] = {}  # status in the ledger

    @property
    def finished(self) -> int:
        """Count of finished episodes."""
        return self.leases.finished_count

    @property
    def promotes(self) -> bool:
        """True while the learners are taking over the winner of a merge."""
        return self.merge is not None and self.merge.chosen is not None

    # -- changes ------------------------------------------------------------------------------------------------

    def issue(self, actor: str, epoch: int) -> bool:
        """Accept a new epoch of an actor, and free the episodes of its older one; return whether there was one."""
        replaced = actor in self.epochs
        if replaced:
            self.leases.give_back(actor)
        self.epochs[actor] = epoch
        self._queue.join(actor)
        for inbox in self.inboxes.values():
            inbox.issue(actor, epoch)
        self._note(LedgerEntry.EPOCH, [actor, epoch])
        return replaced

    def dismiss(self, actor: str, epoch: int) -> None:
        """Close an epoch of an actor that is gone and has no successor, and free its episodes."""
        self.leases.give_back(actor)
        for inbox in self.inboxes.values():
            inbox.close(actor, epoch)
        if self.epochs.get(actor, epoch) <= epoch:
            self.epochs.pop(actor, None)
            self._queue.leave(actor)
        if actor in self.epochs:
            self._queue.join(actor)
        self._note(LedgerEntry.LEFT, [actor, epoch])

    def receive(self, records: Records, payload: bytes, now: float) -> list[Line]:
        """Accept the records of a frame, and of held frames that follow it in order.

        Args:
            records: frame that arrived.
            payload: bytes of the message with the frame.
            now: current time, seconds.

        Returns:
            The lines of the episodes that have finished thereby.
        """
        lines = []
        for frame in self.inboxes[records.stream].receive(records, now):
            self.entries.append((LedgerEntry.FRAME, payload if frame is records else codec.encode(frame)))
            for record in frame.records:
                if frame.stream == EVALUATION:
                    self._add_drive(record)
                elif self.leases.finish(record["episode"], frame.actor):
                    self._queue.note_finished(frame.actor)
                    self.totals.add_episode(record, self.finished)
                    lines.append(record | {"finished_as": self.finished})
                # else the lease has been granted to another actor since
        return lines

    def _add_drive(self, record: dict[str, Any]) -> None:
        if self.merge is not None and record["merge"] == self.merge.index:
            outcome = Outcome(record["outcome"])
            self.merge.add_result(record["candidate"], record["scene_index"], outcome, record["steps"])

    def grant(self, barrier: int, *, evenly: bool = False) -> None:
        """Lease episodes to all actors, as many as they have cars; arguments as in `LeaseQueue.grant`."""
        for arguments in self._queue.grant(self.leases, barrier, evenly=evenly):
            self._note(LedgerEntry.GRANT, arguments)

    def drives(self) -> dict[str, list[Drive]]:
        """Return the validation drives of each actor; they follow from the merge, and are not in the ledger."""
        merge = self.merge
        outstanding, candidates = (merge.outstanding(), merge.candidates) if merge else ([], ())
        return self._deal.deal(merge.index if merge else 0, outstanding, candidates, self.epochs)

    def begin_launch(self, launch: int) -> bool:
        """Go on under a runner; return whether it is another one than before.

        All actors of another one are gone: the episodes that they drove are free, and what they have not delivered is
        lost. A run that was about to end goes on with what is left to do. A merge under way begins again, under an
        index of its own, since a learner may or may not remember its candidates.
        """
        if launch == self.launch:
            return False
        self.launch = launch
        for actor, epoch in list(self.epochs.items()):
            self.dismiss(actor, epoch)
        self.totals.begin_start()
        self.interrupted = False
        self.stage = Stage.TRAIN
        if self.merge is not None:
            self.begin_merge(self.merge.episode, None)
        return True

    def begin_merge(self, episode: int, began_s: float | None) -> None:
        """Begin the merge that is due after `episode` finished episodes; `began_s` as in `Merge`."""
        settings = self._config.merge
        self.merge_index += 1
        self.merge = Merge(
            index=self.merge_index,
            episode=episode,
            candidates=(RECENT, DISTILLED, BEST) if self.totals.merges else (RECENT, DISTILLED),
            scenes=settings.validation_scenes,
            drop_after=settings.drop_after_scenes,
            began_s=began_s,
        )

    def end_merge(self, seconds: float) -> None:
        """End the present merge, whose winner both learners have taken over and kept; it took `seconds`."""
        assert self.merge is not None
        self.totals.merges.append(self.merge.summary(seconds))
        self.merge = None
        self._note(LedgerEntry.MERGED, seconds)

    # -- the ledger ---------------------------------------------------------------------------------------------

    def take_entries(self) -> list[Record]:
        """Return the entries for all changes since the last call."""
        status = self.status()
        changed = {name: value for name, value in status.items() if self._noted.get(name) != value}
        if changed:
            self._note(LedgerEntry.STATUS, changed)
            self._noted = status
        entries, self.entries = self.entries, []
        return entries

    def status(self) -> dict[str, Any]:
        """Return all that does not follow from other entries, as plain data."""
        return {
            "stage": self.stage.value,
            "merge": self.merge and self.merge.outline(),
            "merge_index": self.merge_index,
            "interrupted": self.interrupted,
            "restarts": self.totals.restarts_now,
            "checkpoint": list(self.schedule.state()),
            "max_lag": [self.max_lag_versions, self.max_lag_s],
            "wall_s": self.wall_s,
            "launch": self.launch,
        }

    def base(self) -> dict[str, Any]:
        """Return all that `recover` needs to go on from here; the size depends little on the episodes finished."""
        return {
            "totals": self.totals.state() | {"restarts": self.totals.restarts_before},
            "leases": self.leases.state(),
            "epochs": self.epochs,
            "inboxes": {stream: inbox.state() for stream, inbox in self.inboxes.items()},
            "status": self.status() | {"merge": self.merge and self.merge.state()},
        }

    def recover(self, content: LedgerContent) -> list[Line]:
        """Go on where a predecessor was, from the content of its ledger.

        Returns:
            The lines of the episodes in the ledger's entries, some of which it may not have written any more.
        """
        base, lines = content.base, []
        self.totals.restore(base["totals"])
        self.leases.restore(base["leases"])
        self.epochs = dict(base["epochs"])
        for actor in self.epochs:
            self._queue.join(actor)
        for stream, inbox in self.inboxes.items():
            inbox.restore(base["inboxes"][stream])
        self._follow(base["status"])
        for kind, entry in content.entries:
            match kind:
                case LedgerEntry.FRAME:
                    lines += self.receive(codec.decode(entry, expect=Records), entry, 0.0)
                case LedgerEntry.EPOCH:
                    self.issue(*json.loads(entry))
                case LedgerEntry.LEFT:
                    self.dismiss(*json.loads(entry))
                case LedgerEntry.GRANT:
                    self.leases.grant(*json.loads(entry))
                case LedgerEntry.MERGED:
                    self.end_merge(json.loads(entry))
                case LedgerEntry.STATUS:
                    self._follow(json.loads(entry))
        self.entries.clear()  # the ledger has them already
        return lines

    def _follow(self, status: dict[str, Any]) -> None:
        """Apply fields of a `status`."""
        self.stage = Stage(status.get("stage", self.stage))
        self.interrupted = status.get("interrupted", self.interrupted)
        self.totals.restarts_now = status.get("restarts", self.totals.restarts_now)
        self.max_lag_versions, self.max_lag_s = status.get("max_lag", (self.max_lag_versions, self.max_lag_s))
        self.wall_s = status.get("wall_s", self.wall_s)
        self.launch = status.get("launch", self.launch)
        self.merge_index = status.get("merge_index", self.merge_index)
        if "checkpoint" in status:
            self.schedule.note_checkpoint(*status["checkpoint"])
        if "merge" in status:
            self._follow_merge(status["merge"])

    def _follow_merge(self, merge: dict[str, Any] | None) -> None:
        if merge is None:
            self.merge = None
        elif self.merge is None or self.merge.index != merge["index"]:
            self.merge = Merge.restored(merge)
        else:
            self.merge.began_s = merge["began_s"]

    def _note(self, kind: LedgerEntry, content: Any) -> None:
        self.entries.append((kind, json.dumps(content).encode()))

    # -- checkpoints --------------------------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """Return all that the next start needs to resume, for `restore`; a merge under way begins anew there."""
        return {
            "finished": sorted(self.leases.finished),
            **self.totals.state(),
            "max_lag_versions": self.max_lag_versions,
            "max_lag_s": self.max_lag_s,
            "wall_s": self.wall_s,
            "merge_index": self.merge_index,
        }

    def restore(self, meta: dict[str, Any]) -> None:
        """Restore what `state` returned at an earlier start of the run."""
        self.totals.restore(meta)
        self.leases = Leases(meta["finished"])
        self.max_lag_versions, self.max_lag_s, self.wall_s = (
            meta[name] for name in ("max_lag_versions", "max_lag_s", "wall_s")
        )
        # Checkpoints of earlier versions do not name it; then every merge that was begun had ended.
        self.merge_index = meta.get("merge_index", len(self.totals.merges))
        self.schedule.note_checkpoint(self.finished)
