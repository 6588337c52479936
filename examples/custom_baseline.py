"""Evaluate a baseline of one's own beside ours, on the same scenes.

Usage: `python examples/custom_baseline.py [--scenes ood-layout] [--episodes 20]`. A baseline that belongs to zsdist
itself is added to `zsdist/evaluation/baselines.py`; CONTRIBUTING.md has the steps.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from zsdist import config
from zsdist.common.console import PlainConsole, table
from zsdist.evaluation.baselines import BASELINES, Baseline
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.drivers import Driver, Observability, Observed, See
from zsdist.evaluation.report import Trial, evaluate_all
from zsdist.planning import potential
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose

NAME = "widest-way"
NEAR_M = 1.5  # a direction with less room than this is avoided


class WidestWay(Driver):
    """Drive towards the goal, unless an obstacle is near ahead; then turn to where the camera sees the most room."""

    def __init__(self, see: See) -> None:
        self._see = see

    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """Do nothing: this baseline remembers nothing."""

    def act(self, observed: Observed) -> int:
        """Return the next action. The view has a clearance ahead, to the left and to the right."""
        room_m = self._see(observed).clearance_m
        allowed = observed.allowed.copy()
        allowed[:3] &= room_m > NEAR_M  # the first three actions drive into these directions, the others only turn
        direction = np.array(observed.goal) - observed.pose[:2]
        return int(potential.action_along(direction, observed.pose.heading_rad, allowed) or 0)


def main(arguments: Sequence[str] | None = None) -> dict[str, float]:
    """Drive all policies and return their rates of success by name."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", default="ood-layout", help="family, folder of scene files, or split")
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--against", nargs="*", default=["random", "potential-field"], help="baselines of zsdist")
    parser.add_argument("--quick", action="store_true", help="a few seconds, to see that it works")
    options = parser.parse_args(arguments)
    changes: tuple[str, ...] = ()
    if options.quick:
        options.episodes, options.against = 1, ["random"]
        changes = ("vision.network=student", "camera.size_px=128", "sim.max_steps=10")
    BASELINES[NAME] = Baseline("towards the goal, else where there is room", Observability.CAMERA, make)
    settings = config.load(None, changes)
    trials = [
        Trial(name, Contender(settings, baseline=name), None, options.scenes, options.episodes)
        for name in (NAME, *options.against)
    ]
    # One process: another one would not know the baseline that was added here.
    reports = evaluate_all(trials, seed=0, workers=1)
    rows = []
    for trial, report in zip(trials, reports, strict=True):
        result = report.result
        low, high = result["confidence_95"]["success"]
        rows.append([trial.name, f"{result['success']:.2f} ({low:.2f}-{high:.2f})", f"{result['collision']:.2f}"])
    PlainConsole().print(table((f"on {options.scenes}", "success", "collision"), rows))
    return {trial.name: report.result["success"] for trial, report in zip(trials, reports, strict=True)}


def make(settings: config.Config, see: See) -> Driver:
    """Return a new driver of the baseline."""
    return WidestWay(see)


if __name__ == "__main__":
    main()
