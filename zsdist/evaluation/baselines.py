"""Baselines: policies without learning, with which learned policies are compared."""

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

ARRIVAL_SLACK_M = 0.10  # A* aims this far inside the success radius, since the car ends off a cell's centre

_NOTHING_LEARNED = {
    level: {"output.weight": np.zeros((actions, size), np.float32), "output.bias": np.zeros(actions, np.float32)}
    for level, size, actions in (
        (Level.HIGH, HIGH_STATE_SIZE, HIGH_ACTIONS),
        (Level.LOW, LOW_STATE_SIZE, LOW_ACTIONS),
    )
}


class Random(Driver):
    """Uniform choice among the actions that stay on the grid."""

    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """Keep the generator of the episode."""
        self._rng = rng

    def act(self, observed: Observed) -> int:
        """Return a uniformly drawn action."""
        return int(self._rng.choice(np.flatnonzero(observed.allowed)))


class GoalGreedy(Driver):
    """Straight drive to the goal, regardless of obstacles."""

    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """Do nothing: the policy keeps no state."""

    def act(self, observed: Observed) -> int:
        """Return the action after which the car points most directly at the goal."""
        pose = observed.pose
        direction = np.array(observed.goal) - pose[:2]
        action = potential.action_along(direction, pose.heading_rad, observed.allowed)
        assert action is not None, "turns in place never lead off the grid"
        return int(action)


class AStar(Driver):
    """Shortest path on the whole true map without walking obstacles: the best possible drive in a static scene."""

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
        """Return the plan's action at the true pose, or a turn in place where no path leads to the goal."""
        state = self._grid.lattice_state(observed.pose)
        if not math.isfinite(self._cost[state.iy, state.ix, state.heading]):
            return int(Action.TURN_LEFT_90)
        way = shortest_path.path(self._cost, self._blocked, state, self._metres)
        return int(way.actions[0]) if way.actions else int(Action.FORWARD)


def _unlearned(low_policy: str, **agent: float) -> Callable[[Config, See], Driver]:
    """Return a factory of agents with the goal as the only subgoal and with `low_policy` as the low level."""

    def make(config: Config, see: See) -> Driver:
        settings = config.agent.model_copy(update={"high_policy": "goal", "low_policy": low_policy, **agent})
        return LearnedDriver(config.model_copy(update={"agent": settings}), _NOTHING_LEARNED, see)

    return make


@dataclass(frozen=True)
class Baseline:
    """Entry of the list of baselines.

    Attributes:
        line: description in one line.
        observability: part of its surroundings that the policy observes.
        make: factory of its drivers.
    """

    line: str
    observability: Observability
    make: Callable[[Config, See], Driver]


BASELINES: dict[str, Baseline] = {
    "random": Baseline("any action that stays on the grid", Observability.NOTHING, lambda config, see: Random()),
    "goal-greedy": Baseline("straight at the goal", Observability.NOTHING, lambda config, see: GoalGreedy()),
    "potential-field": Baseline(
        "potential field on the believed map, under the shield", Observability.CAMERA, _unlearned("field")
    ),
    "potential-field-no-trail": Baseline(
        "the same field without repulsion from visited states", Observability.CAMERA, _unlearned("field", trail=0.0)
    ),
    "astar": Baseline(
        "shortest path over (cell, heading) on the true map, planned once",
        Observability.MAP,
        lambda config, see: AStar(config),
    ),
    "astar-frontier": Baseline(
        "shortest path on the map built from true distances, planned anew at each step, under the shield",
        Observability.RANGES,
        _unlearned("planner"),
    ),
    "astar-vision": Baseline(
        "the same on the map built by the visual-act model", Observability.CAMERA, _unlearned("planner")
    ),
}
