"""Recorded steps of a policy in simulation, and the proof that a bundle decides the same: masks, values and action."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import safetensors
import safetensors.numpy

from zsdist.errors import BundleError
from zsdist.runtime.bundle import PARITY_FILE, Bundle
from zsdist.runtime.runner import BundleRunner, RunnerDecision
from zsdist.types import Action, Level, Pose

TOLERANCE = 1e-4
"""Largest difference allowed between values, per unit of the largest value of the step, or of 1 where all are less."""

COLUMNS = {
    "episode": "int32, number of the episode; the map begins empty where it changes",
    "picture": "(px, px, 3) uint8, picture at the pose",
    "pose": "(3,) float64, x and y in metres and heading in radians",
    "goal": "(2,) float64, x and y in metres",
    "high_mask": "(9,) uint8, 1 for each option that the high level might choose",
    "low_mask": "(5,) uint8, 1 for each action that the low level might take",
    "high_decided": "uint8, 1 where the high level chose a new option",
    "high_values": "(9,) float32, values of the options; 0 where it did not choose",
    "low_decided": "uint8, 1 where the low-level network chose the action",
    "low_values": "(5,) float32, values of the actions; 0 where a planner chose",
    "action": "uint8, number of the action",
}
"""Columns of the file, one row for each step."""

Steps = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class ParityResult:
    """Result of a check that found no difference.

    Attributes:
        steps: number of steps.
        episodes: number of episodes.
        difference: largest difference of a value, in the units of `TOLERANCE`.
    """

    steps: int
    episodes: int
    difference: float


def choices(masks: Mapping[Level, np.ndarray], values: Mapping[Level, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the columns of one step that say what both levels might choose, and how they valued it."""
    columns = {}
    for level, mask in masks.items():
        valued = values.get(level)
        columns[f"{level}_mask"] = mask.astype(np.uint8)
        columns[f"{level}_decided"] = np.array(valued is not None, np.uint8)
        columns[f"{level}_values"] = np.zeros(len(mask), np.float32) if valued is None else valued
    return columns


def check(
    bundle: Bundle, threads: int = 1, on_step: Callable[[int, int], None] = lambda done, total: None
) -> ParityResult:
    """Replay the recorded steps of a bundle, each picture at its recorded pose, and compare all decisions.

    Args:
        bundle: bundle of the policy.
        threads: number of threads of each network.
        on_step: called after each step with the number of steps done and of all steps.

    Raises:
        BundleError: a step differs, and which; or the file is not of such steps.
    """
    steps, runner = _read(bundle), BundleRunner(bundle, threads)
    total, worst = len(steps["action"]), 0.0
    for step in range(total):
        pose, goal = Pose(*steps["pose"][step].tolist()), tuple(steps["goal"][step].tolist())
        begins = step == 0 or steps["episode"][step] != steps["episode"][step - 1]
        if begins:
            runner.begin(pose, goal)
        decision = runner.decide(steps["picture"][step], pose)
        worst = max(worst, _compare(bundle, steps, step, decision))
        on_step(step + 1, total)
    return ParityResult(total, len(np.unique(steps["episode"])), worst)


def _compare(bundle: Bundle, steps: Steps, step: int, decision: RunnerDecision) -> float:
    """Return the largest difference of a value in a step; raise `BundleError` where the decision is another one."""
    place = f"bundle {bundle.folder} fails at step {step} (episode {steps['episode'][step]})"
    if decision.action is None:
        raise BundleError(f"{place}: there is no action, since {decision.no_way or 'the goal is reached'}")
    worst, found = 0.0, choices(decision.masks, decision.values)
    for level in Level:
        for name in (f"{level}_mask", f"{level}_decided"):
            if not np.array_equal(found[name], steps[name][step]):
                raise BundleError(
                    f"{place}: {name} is {found[name].tolist()}; recorded is {steps[name][step].tolist()}"
                )
        ours, theirs = found[f"{level}_values"], steps[f"{level}_values"][step]
        difference = float(np.abs(ours - theirs).max() / max(1.0, np.abs(theirs).max()))
        if not difference <= TOLERANCE:
            raise BundleError(f"{place}: {level}_values differ by {difference:.2g}; allowed is {TOLERANCE:g}")
        worst = max(worst, difference)
    recorded = int(steps["action"][step])
    if decision.action != recorded:
        raise BundleError(f"{place}: the action is {decision.action.name}; recorded is {Action(recorded).name}")
    return worst


def _read(bundle: Bundle) -> Steps:
    path: Path = bundle.folder / PARITY_FILE
    try:
        steps = safetensors.numpy.load_file(path)
    except (OSError, safetensors.SafetensorError) as error:
        raise BundleError(f"bundle {path} cannot be read: {' '.join(str(error).split())}") from error
    lengths = {len(column) for column in steps.values() if column.ndim}
    if set(steps) != set(COLUMNS) or len(lengths) != 1 or not min(lengths):
        raise BundleError(f"bundle {path} has the columns {', '.join(sorted(steps))}; allowed are {', '.join(COLUMNS)}")
    return steps
