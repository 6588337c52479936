"""Content of `summary.json`, made of the totals of a run and the last states of its roles."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

from zsdist.roles.replay import shards
from zsdist.roles.scheduler.totals import RunTotals
from zsdist.telemetry.snapshot import Snapshot
from zsdist.types import Level
from zsdist.wire.messages import State


def run_summary(
    totals: RunTotals,
    states: Mapping[str, State],
    snapshot: Snapshot,
    *,
    finished: int,
    interrupted: bool,
    wall_s: float,
) -> dict[str, Any]:
    """Return the content of `summary.json`.

    Args:
        totals: totals of the run.
        states: states of all learners and shards of the replay, from the last checkpoint.
        snapshot: statistics of all roles.
        finished: count of finished episodes.
        interrupted: whether the run was stopped early.
        wall_s: real seconds that the run took, earlier starts included.
    """
    learners = {level: states[f"learner-{level}"].meta for level in Level}
    transitions: dict[str, Counter[str]] = {level.value: Counter() for level in Level}
    for name, state in states.items():
        if shards.is_state_name(name):
            for level, counts in transitions.items():
                counts.update(state.meta[level]["books"])
    return {
        "episodes": finished,
        "ended": "interrupted" if interrupted else "complete",
        "env_steps": totals.env_steps,
        "learner_updates": {level.value: meta["updates"] for level, meta in learners.items()},
        "transitions": {level: dict(counts) for level, counts in transitions.items()},
        "weights": {
            "version": {level.value: meta["version"] for level, meta in learners.items()},
            "max_lag_versions": snapshot.max_lag_versions,
            "max_lag_s": snapshot.max_lag_s,
            "sha256": {level.value: meta["sha256"] for level, meta in learners.items()},
        },
        "merges": totals.merges,
        "outcomes": {outcome.value: count for outcome, count in totals.outcomes.items()},
        "rates": {
            "env_steps_per_s": round(totals.env_steps / max(wall_s, 1e-9), 2),
            "episodes_per_min": round(60 * finished / max(wall_s, 1e-9), 2),
        },
        "restarts": totals.restarts(),
        "wall_s": wall_s,
    }
