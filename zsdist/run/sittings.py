"""Sittings: the stretches that a run on a virtual clock is made of, so that it is resumed to the bit.

A sitting builds all roles from the states of the last checkpoint, drives a few episodes to their end, a due merge
included, closes all roles as at the end of a run, and writes the next checkpoint. A run that is never stopped is thus
the same chain of sittings as one that is stopped and resumed: what came after the last checkpoint is driven again, with
the same result. Whatever a role does may follow from its state, the settings and the clock alone.
"""

import itertools
import threading
from collections.abc import Mapping
from dataclasses import replace

from zsdist.config import Config
from zsdist.roles.base import Role
from zsdist.roles.scheduler.merge import next_merge_at
from zsdist.roles.scheduler.summary import run_summary
from zsdist.roles.scheduler.totals import RunTotals
from zsdist.run import directory
from zsdist.run.program import ActorParts, RoleSpec, RunSpec
from zsdist.telemetry.snapshot import Snapshot
from zsdist.transport.base import Transport
from zsdist.wire.messages import State

LONGEST = 10  # episodes of a sitting, at most: some seconds of work, a minute where every episode is a long one

States = Mapping[str, State]  # states of all roles by name, as a checkpoint has them


def finished(states: States) -> int:
    """Return the number of finished episodes at a checkpoint; 0 before the first one."""
    return len(states["scheduler"].meta["finished"]) if states else 0


def time_s(states: States) -> float:
    """Return the time at which the clock stood at a checkpoint; 0 before the first one."""
    return float(states["scheduler"].meta.get("time_s", 0.0)) if states else 0.0


def end(config: Config, states: States) -> int:
    """Return the number of finished episodes at which the next sitting ends.

    Before the first checkpoint it is 0: that sitting only writes one. After it, sittings end at the multiples of
    `run.checkpoint_every_episodes`, or of `LONGEST` where that is less, and at every merge.

    Args:
        config: configuration of the run.
        states: states at the checkpoint from which the sitting begins; empty before the first one.
    """
    if not states:
        return 0
    begin, length = finished(states), min(config.run.checkpoint_every_episodes, LONGEST)
    # A merge is overdue where `merge.every_episodes` has changed, or a run with another clock was stopped in its last.
    return max(begin, min((begin // length + 1) * length, _merge_due(config, states), config.run.episodes))


def is_complete(config: Config, states: States) -> bool:
    """Return whether nothing is left to do after a checkpoint: all episodes are driven, and no merge is due."""
    return finished(states) >= config.run.episodes and _merge_due(config, states) > finished(states)


def conclude(spec: RunSpec, states: States, begun: int) -> None:
    """Make the folder of a run agree with its last checkpoint, and write its summary.

    Args:
        spec: specification of the run.
        states: states at the checkpoint.
        begun: number of finished episodes and of those that were begun; a resumed run drives those after the checkpoint
            again.
    """
    meta, totals, snapshot = states["scheduler"].meta, RunTotals(spec.config), Snapshot()
    totals.restore(meta)
    snapshot.max_lag_versions, snapshot.max_lag_s = meta["max_lag_versions"], meta["max_lag_s"]
    complete = is_complete(spec.config, states)
    summary = run_summary(
        totals, states, snapshot, finished=finished(states), interrupted=not complete, wall_s=float(meta["wall_s"])
    )
    if not complete:
        summary["driven_again"] = begun - finished(states)
        directory.rewind(spec.folder, spec.config, dict(states))
    directory.write_summary(spec.folder, summary)


def _merge_due(config: Config, states: States) -> int:
    merges = states["scheduler"].meta["merges"] if states else []
    return next_merge_at(merges[-1]["episode"] if merges else 0, config.merge.every_episodes, config.run.episodes)


class Belongings:
    """Things that outlive the sittings of one start: the open files of the run, and the simulations of its actors.

    Episodes do not influence one another in a simulation, so a car that has driven others drives one to the same bits.
    """

    def __init__(self, spec: RunSpec) -> None:
        """Open the files of a run."""
        self._directory = spec.open_directory()
        self._parts: dict[str, ActorParts] = {}

    def build(self, spec: RunSpec, role_spec: RoleSpec, transport: Transport, wake: threading.Event) -> Role:
        """Return a role, made as `RunSpec.build` makes it, of the parts that there are already."""
        if role_spec.role == "actor" and role_spec.name not in self._parts:
            made = spec.make_parts(spec.config)
            envs = [made.make_env() for _ in range(spec.config.run.cars_per_actor)]
            self._parts[role_spec.name] = replace(made, make_env=itertools.cycle(envs).__next__)
        return spec.build(role_spec, transport, wake, self._parts.get(role_spec.name), self._directory)

    def close(self) -> None:
        """Close the files."""
        self._directory.close()
