"""Policies without learning that every learned one is held against, by name and one line each."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from zsdist.agent.blocks import HIGH_ACTIONS
from zsdist.agent.features import HIGH_STATE_SIZE, LOW_ACTIONS, LOW_STATE_SIZE
from zsdist.config import Config
from zsdist.evaluation.drivers import Driver, LearnedDriver, Observed, See, Sees
from zsdist.evaluation.planners import AStar, FrontierAStar
from zsdist.planning import potential
from zsdist.sim.scene import Scene
from zsdist.types import Level, Pose

_NOTHING_LEARNED = {
    level: {"output.weight": np.zeros((actions, size), np.float32), "output.bias": np.zeros(actions, np.float32)}
    for level, size, actions in (
        (Level.HIGH, HIGH_STATE_SIZE, HIGH_ACTIONS),
        (Level.LOW, LOW_STATE_SIZE, LOW_ACTIONS),
    )
}


class Random(Driver):
    """Any action that does not lead off the grid, each as likely."""

    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """Takes the episode's randomness."""
        self._rng = rng

    def act(self, observed: Observed) -> int:
        """A uniform draw."""
        return int(self._rng.choice(np.flatnonzero(observed.allowed)))


class GoalGreedy(Driver):
    """Turns to the goal and drives there, whatever stands in the way."""

    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """Nothing to prepare."""

    def act(self, observed: Observed) -> int:
        """The action after which the car points best at the goal."""
        pose = observed.pose
        direction = np.array(observed.goal) - pose[:2]
        return int(potential.decompose(direction, pose.heading_rad, observed.allowed))


def _potential_field(config: Config, see: See) -> Driver:
    """The agent itself with the field in the low level's place and the goal as its only subgoal; nothing is learned."""
    agent = config.agent.model_copy(update={"high_policy": "goal", "low_policy": "field"})
    return LearnedDriver(config.model_copy(update={"agent": agent}), _NOTHING_LEARNED, see)


def _without_trail(config: Config, see: See) -> Driver:
    return _potential_field(config.model_copy(update={"agent": config.agent.model_copy(update={"trail": 0.0})}), see)


@dataclass(frozen=True)
class Baseline:
    """One entry of the list: its `line` says what it does, `sees` what it is shown."""

    line: str
    sees: Sees
    make: Callable[[Config, See], Driver]


BASELINES: dict[str, Baseline] = {
    "random": Baseline("any action that stays on the grid", Sees.NOTHING, lambda config, see: Random()),
    "goal-greedy": Baseline("straight at the goal", Sees.NOTHING, lambda config, see: GoalGreedy()),
    "potential-field": Baseline("the field's direction under the shield, no learning", Sees.CAMERA, _potential_field),
    "potential-field-no-trail": Baseline("the same, not repelled from where it has been", Sees.CAMERA, _without_trail),
    "astar": Baseline("shortest way over (cell, heading), planned once", Sees.MAP, lambda config, see: AStar(config)),
    "astar-frontier": Baseline(
        "shortest way on what it has seen so far, planned anew at each step", Sees.RANGES, FrontierAStar
    ),
    "astar-vision": Baseline("the same on what the visual-act model says", Sees.CAMERA, FrontierAStar),
}
