"""Metrics of evaluated episodes: pure functions of records; lengths in metres, rates in [0, 1]."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from zsdist.evaluation.records import EpisodeRecord
from zsdist.evaluation.statistics import bootstrap_95, wilson_95
from zsdist.types import Outcome


def spl(record: EpisodeRecord) -> float | None:
    """Return success weighted by path length: 1 for the shortest path, 0 for a failure.

    It is None where the planner knows no path, since nothing tells how long the shortest one is.
    """
    detour = _detour(record)
    return detour if detour is None or record.outcome is Outcome.SUCCESS else 0.0


def soft_spl(record: EpisodeRecord) -> float | None:
    """Return `spl` with progress in place of success: the share by which the remaining path became shorter."""
    detour = _detour(record)
    if detour is None or record.outcome is Outcome.SUCCESS:
        return detour
    if not record.shortest_m or record.remaining_m is None:
        return 0.0
    return max(0.0, 1.0 - record.remaining_m / record.shortest_m) * detour


def path_efficiency(record: EpisodeRecord) -> float | None:
    """Return the length of the shortest path divided by the length of the driven path, at most 1.

    It is None for a failure, whose path leads nowhere, and where the planner knows no path.
    """
    return _detour(record) if record.outcome is Outcome.SUCCESS else None


def step_efficiency(record: EpisodeRecord) -> float | None:
    """Return the fewest steps divided by the steps taken: "step costs compared to the shortest possible paths" (paper).

    It is None where `path_efficiency` is.
    """
    if record.outcome is not Outcome.SUCCESS or record.fewest_steps is None:
        return None
    if record.fewest_steps == 0:
        return 1.0  # the start lies within the goal's radius: nothing is to be driven
    return record.fewest_steps / record.steps if record.steps else None


def summarise(records: Sequence[EpisodeRecord], rng: np.random.Generator) -> dict[str, object]:
    """Return the figures of an evaluation's JSON, from `success` to `per_scene`.

    SPL and SoftSPL cover the scenes in which nothing moves, the efficiencies the successful episodes, and all four only
    scenes in which the planner knows a path. A figure without any such episode is None and has no interval.
    `shield_changed_share` is a share of all decisions.

    Args:
        records: episodes, at least one.
        rng: generator of the bootstrap.

    Raises:
        ValueError: there is no episode.
    """
    if not records:
        raise ValueError("there are no episodes; a summary needs at least one")
    static = [record for record in records if record.static]
    means = {
        "spl": [value for record in static if (value := spl(record)) is not None],
        "soft_spl": [value for record in static if (value := soft_spl(record)) is not None],
        "path_efficiency": [value for record in records if (value := path_efficiency(record)) is not None],
        "step_efficiency": [value for record in records if (value := step_efficiency(record)) is not None],
        "min_clearance_m": [record.min_clearance_m for record in records],
    }
    counts = {outcome.value: sum(record.outcome is outcome for record in records) for outcome in Outcome}
    decisions = np.concatenate([record.decision_ms for record in records])
    p50, p99 = np.quantile(decisions, (0.5, 0.99)).tolist() if len(decisions) else (None, None)
    return {
        **{name: count / len(records) for name, count in counts.items()},
        **{name: float(np.mean(values)) if values else None for name, values in means.items()},
        "shield_changed_share": sum(record.shield_changes for record in records) / max(len(decisions), 1),
        "decision_ms": {"p50": p50, "p99": p99},
        "confidence_95": {
            **{name: list(wilson_95(count, len(records))) for name, count in counts.items()},
            **{name: list(bootstrap_95(np.array(values), rng)) for name, values in means.items() if values},
        },
        "per_scene": [scene_entry(record) for record in records],
    }


def scene_entry(record: EpisodeRecord) -> dict[str, Any]:
    """Return the entry of an episode in `per_scene`."""
    return {
        "scene": record.scene,
        "outcome": record.outcome.value,
        "steps": record.steps,
        "path_m": record.path_m,
        "shortest_m": record.shortest_m,
        "min_clearance_m": record.min_clearance_m,
    }


def summarise_scenes(
    records: Sequence[EpisodeRecord], scenes: Sequence[str], rng: np.random.Generator
) -> dict[str, object]:
    """Return the figures of `summarise`, with intervals that count each scene once, and `distinct_scenes`.

    An evaluation with more episodes than scenes repeats them. A greedy policy drives a scene the same way again, so a
    repeat says nothing new about the policy. The first drive of each scene counts.

    Args:
        records: episodes, at least one.
        scenes: hash of the scene of each episode.
        rng: generator of the bootstrap.
    """
    summary = summarise(records, rng)
    first = {scene: record for scene, record in reversed(list(zip(scenes, records, strict=True)))}
    if len(first) < len(records):
        summary["confidence_95"] = summarise(list(first.values())[::-1], rng)["confidence_95"]
    return summary | {"distinct_scenes": len(first)}


def _detour(record: EpisodeRecord) -> float | None:
    """Return shortest over driven path length, at most 1; None where the planner knows no path, though the car may.

    It is 1 where the start lies within the goal's radius: nothing is to be driven, so no way is longer than needed.
    """
    if record.shortest_m is None:
        return None
    return record.shortest_m / max(record.path_m, record.shortest_m) if record.shortest_m > 0 else 1.0
