"""Drivers that plan the shortest way over (cell, heading): on the true map, or on the map of what they saw."""

import math

import numpy as np
from scipy.ndimage import binary_dilation

from zsdist.agent.hierarchy import START_DISC_M
from zsdist.config import Config
from zsdist.evaluation.drivers import Driver, Observed, See
from zsdist.planning import shortest_path
from zsdist.planning.belief import BeliefMap
from zsdist.planning.grid import Grid
from zsdist.sim.scene import Scene
from zsdist.sim.solvability import footprints
from zsdist.types import Action, Pose

ARRIVAL_SLACK_M = 0.10  # planners aim this far inside the success radius: that near to a cell's centre the car ends
ACTION_REACH_M = 2.2  # no action sweeps ground farther from the car's centre
LOOKS = 3  # turns in place that show all sides
KNOWN_AROUND = 2  # squares about seen ones that are known too: no obstacle is so small as to hide in them


class Planner:
    """The first step of the shortest way to a goal over a map of occupied space."""

    def __init__(self, config: Config) -> None:
        self.grid = Grid.from_config(config.grid)
        self._table = footprints(self.grid)
        self._metres = shortest_path.metres_cost(self.grid)
        self._radius_m = config.sim.success_radius_m - ARRIVAL_SLACK_M

    def prepare(self, occupancy: np.ndarray, goal: tuple[float, float], pose: Pose) -> bool:
        """Takes a map, `(fine_size, fine_size)` bool, and a goal; returns whether a way leads there from the pose."""
        self._blocked = self._table.blocked(occupancy)
        goals = shortest_path.goal_mask(self.grid, goal, self._radius_m)
        self._cost = shortest_path.cost_to_go(self._blocked, goals, self._metres)
        state = self.grid.lattice_state(pose)
        return math.isfinite(self._cost[state.iy, state.ix, state.heading])

    def step(self, pose: Pose) -> int:
        """The next action; where no way is known, the first turn in place (or else move) that hits nothing."""
        state = self.grid.lattice_state(pose)
        if math.isfinite(self._cost[state.iy, state.ix, state.heading]):
            way = shortest_path.path(self._cost, self._blocked, state, self._metres)
            if way.actions:
                return int(way.actions[0])
        free = self.free(pose)
        order = (Action.TURN_LEFT_90, Action.TURN_RIGHT_90, Action.FORWARD, Action.LEFT_45, Action.RIGHT_45)
        return int(next((action for action in order if free[action]), Action.TURN_LEFT_90))

    def free(self, pose: Pose) -> np.ndarray:
        """Actions that hit nothing on the map, `(5,)` bool."""
        state = self.grid.lattice_state(pose)
        return ~self._blocked[state.iy, state.ix, state.heading]


class AStar(Driver):
    """The shortest way on the whole true map: what is possible at best."""

    def __init__(self, config: Config) -> None:
        self._planner = Planner(config)

    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """Plans once; `truth` is the scene."""
        if truth is None:
            raise ValueError("A* on the true map needs the scene")
        self._planner.prepare(truth.occupancy(self._planner.grid), goal, pose)

    def act(self, observed: Observed) -> int:
        """The plan's action at the true pose."""
        return self._planner.step(observed.pose)


class FrontierAStar(Driver):
    """Plans anew at each step on a belief map of what it saw.

    What was not seen is taken for free from afar, but not driven into: once the car has been within an action's reach
    of it, it counts as occupied until it is seen. Where no way is left the car looks around before it takes the risk.
    """

    def __init__(self, config: Config, see: See) -> None:
        self._planner = Planner(config)
        self._see = see
        self._forward_m = config.camera.forward_m

    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """An empty map but for the disc about the start."""
        grid = self._planner.grid
        self._goal = goal
        self._belief = BeliefMap(grid)
        self._belief.clear_disc(pose.x_m, pose.y_m, START_DISC_M)
        self._looks = 0
        self._approached = np.zeros((grid.fine_size, grid.fine_size), dtype=bool)

    def act(self, observed: Observed) -> int:
        """Looks, then plans."""
        pose = observed.pose
        self._belief.update(pose, self._see(observed), self._forward_m)
        xs, ys = self._planner.grid.fine_centres()
        self._approached |= np.hypot(xs[None, :] - pose.x_m, ys[:, None] - pose.y_m) <= ACTION_REACH_M
        occupied = self._belief.occupied()
        unseen = self._approached & ~binary_dilation(self._belief.seen(), iterations=KNOWN_AROUND)
        if self._planner.prepare(occupied | unseen, self._goal, pose):
            self._looks = 0
        elif self._looks < LOOKS and self._planner.free(pose)[Action.TURN_LEFT_90]:
            self._looks += 1
            return int(Action.TURN_LEFT_90)
        else:
            self._planner.prepare(occupied, self._goal, pose)
        return self._planner.step(pose)
