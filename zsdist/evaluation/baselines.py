"""Baselines: policies without learning with which every learned one is compared, by name and one line each."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from zsdist.agent.blocks import HIGH_ACTIONS
from zsdist.agent.features import HIGH_STATE_SIZE, LOW_ACTIONS, LOW_STATE_SIZE
from zsdist.config import Config
from zsdist.evaluation.drivers import Driver, LearnedDriver, Observability, Observed, See
from zsdist.planning import potential, shortest_path
from zsdist.planning.grid import Grid
from zsdist.sim.scenes.scene import Scene
from zsdist.sim.scenes.solvability import footprints
from zsdist.types import Action, Level, Pose

ARRIVAL_SLACK_M = 0.10  # A* aims this far inside the success radius: that near to a cell's centre the car ends

_NOTHING_LEARNED = {
    level: {"output.weight": np.zeros((actions, size), np.float32), "output.bias": np.zeros(actions, np.float32)}
    for level, size, actions in (
        (Level.HIGH, HIGH_STATE_SIZE, HIGH_ACTIONS),
        (Level.LOW, LOW_STATE_SIZE, LOW_ACTIONS),
    )
}


class Random(Driver):
    """Draws any action that does not lead off the grid, each as likely."""

    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """Take the episode's randomness."""
        self._rng = rng

    def act(self, observed: Observed) -> int:
        """Return a uniform draw."""
        return int(self._rng.choice(np.flatnonzero(observed.allowed)))


class GoalGreedy(Driver):
    """Turns to the goal and drives there, through whatever stands in the way."""

    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """Prepare nothing."""

    def act(self, observed: Observed) -> int:
        """Return the action after which the car points best at the goal."""
        pose = observed.pose
        direction = np.array(observed.goal) - pose[:2]
        action = potential.action_along(direction, pose.heading_rad, observed.allowed)
        assert action is not None, "turns in place never lead off the grid"
        return int(action)


class AStar(Driver):
    """Drives the shortest way on the whole true map without walking obstacles: the best possible in a still scene."""

    def __init__(self, config: Config) -> None:
        self._grid = Grid.from_config(config.grid)
        self._metres = shortest_path.metres_cost(self._grid)
        self._radius_m = config.sim.success_radius_m - ARRIVAL_SLACK_M

    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """Plan once; `truth` is the scene."""
        if truth is None:
            raise ValueError("A* plans on the true map and needs the scene")
        self._blocked = footprints(self._grid).blocked(truth.occupancy(self._grid))
        goals = shortest_path.goal_mask(self._grid, goal, self._radius_m)
        self._cost = shortest_path.cost_to_go(self._blocked, goals, self._metres)

    def act(self, observed: Observed) -> int:
        """Return the plan's action at the true pose, or a turn in place where no way leads on."""
        state = self._grid.lattice_state(observed.pose)
        if not math.isfinite(self._cost[state.iy, state.ix, state.heading]):
            return int(Action.TURN_LEFT_90)
        way = shortest_path.path(self._cost, self._blocked, state, self._metres)
        return int(way.actions[0]) if way.actions else int(Action.FORWARD)


def _unlearned(low_policy: str, **agent: float) -> Callable[[Config, See], Driver]:
    """Return a maker of the agent with the goal as its only subgoal and `low_policy` in the low level's place."""

    def make(config: Config, see: See) -> Driver:
        settings = config.agent.model_copy(update={"high_policy": "goal", "low_policy": low_policy, **agent})
        return LearnedDriver(config.model_copy(update={"agent": settings}), _NOTHING_LEARNED, see)

    return make


@dataclass(frozen=True)
class Baseline:
    """Entry of the list: `line` is its description, `observability` what it observes."""

    line: str
    observability: Observability
    make: Callable[[Config, See], Driver]


BASELINES: dict[str, Baseline] = {
    "random": Baseline("any action that stays on the grid", Observability.NOTHING, lambda config, see: Random()),
    "goal-greedy": Baseline("straight at the goal", Observability.NOTHING, lambda config, see: GoalGreedy()),
    "potential-field": Baseline(
        "down the field on the map of what it sees, under the shield", Observability.CAMERA, _unlearned("field")
    ),
    "potential-field-no-trail": Baseline(
        "the same, not repelled from where it has been", Observability.CAMERA, _unlearned("field", trail=0.0)
    ),
    "astar": Baseline(
        "shortest way over (cell, heading), planned once", Observability.MAP, lambda config, see: AStar(config)
    ),
    "astar-frontier": Baseline(
        "shortest way on the map of what it saw, planned anew at each step, under the shield",
        Observability.RANGES,
        _unlearned("planner"),
    ),
    "astar-vision": Baseline("the same by what the visual-act model says", Observability.CAMERA, _unlearned("planner")),
}
