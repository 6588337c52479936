"""Policies without learning that every learned one is held against, by name and one line each."""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from zsdist.agent import shield
from zsdist.agent.hierarchy import START_DISC_M
from zsdist.config import Config
from zsdist.evaluation.drivers import RANGE_ANGLES_RAD, Driver, Observed, Sees, VisualAct, look
from zsdist.planning import potential, shortest_path
from zsdist.planning.belief import BeliefMap
from zsdist.planning.footprint import successor
from zsdist.planning.grid import Grid
from zsdist.sim.scene import Scene
from zsdist.sim.solvability import footprints
from zsdist.types import Action, LatticeState, Pose, View

ARRIVAL_SLACK_M = 0.10  # planners aim this far inside the success radius: that near to a cell's centre the car ends
ACTION_REACH_M = 2.2  # no action sweeps ground farther from the car's centre
LOOKS = 3  # turns in place that show all sides
KNOWN_AROUND = 2  # squares about seen ones that are known too: no obstacle is so small as to hide in them
RANGE_EDGES_M = np.linspace(
    0.05, 5.0, 100, dtype=np.float32
)  # bins of a true distance, fine beside the squares of the map


class Random(Driver):
    """Any action that does not lead off the grid, each as likely."""

    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """Takes the episode's randomness."""
        self._rng = rng

    def act(self, observed: Observed) -> int:
        """A uniform draw."""
        return int(self._rng.choice(np.flatnonzero(observed.allowed)))


class PotentialField(Driver):
    """Where the field points, on the map that the camera showed, under the agent's shield; the goal is the target.

    Nothing is learned but the map; where the car has been repels it, without which it stays in the first pocket.
    """

    def __init__(self, config: Config, visual_act: VisualAct) -> None:
        self._config = config
        self._grid = Grid.from_config(config.grid)
        self._visual_act = visual_act

    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """An empty map but for the disc about the start."""
        self.shield_changes = 0
        self._goal = goal
        self._goals = shortest_path.goal_mask(self._grid, goal, self._config.sim.success_radius_m)
        self._belief = BeliefMap(self._grid)
        self._belief.clear_disc(pose.x_m, pose.y_m, START_DISC_M)
        self._visits: Counter[LatticeState] = Counter()

    def act(self, observed: Observed) -> int:
        """Looks, then turns and moves down the field as far as the shield allows."""
        self._belief.update(observed.pose, look(self._visual_act, observed), self._config.camera.forward_m)
        state = self._grid.lattice_state(observed.pose)
        self._visits[state] += 1
        judgement = shield.judge(self._belief, state, self._goals)
        mask, _ = shield.mask(judgement.blocked, judgement.live, state)
        direction = self._force(observed.pose)
        ends = [successor(state, action) for action in Action]
        reluctance = self._config.agent.trail * np.array([min(self._visits[end], 1) for end in ends], dtype=float)
        wanted = potential.decompose(direction, observed.pose.heading_rad, observed.allowed, reluctance)
        action = potential.decompose(direction, observed.pose.heading_rad, mask, reluctance)
        self.shield_changes += action != wanted
        return int(action)

    def _force(self, pose: Pose) -> np.ndarray:
        xs, ys = self._grid.fine_centres()
        rows, columns = np.nonzero(self._belief.occupied())
        settings = self._config.agent
        return potential.force(
            pose[:2],
            self._goal,
            np.stack([xs[columns], ys[rows]], axis=1),
            k_att=settings.attraction,
            k_rep=settings.repulsion,
            influence_m=settings.influence_m,
            trail=np.array([self._grid.centre(state.ix, state.iy) for state in self._visits.elements()]),
            k_trail=settings.trail,
        )


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
    """Plans anew at each step on a belief map of true distances in view.

    What was not seen is taken for free from afar, but not driven into: once the car has been within an action's reach
    of it, it counts as occupied until it is seen. Where no way is left the car looks around before it takes the risk.
    """

    def __init__(self, config: Config) -> None:
        self._planner = Planner(config)
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
        """Takes the ranges in, then plans."""
        pose = observed.pose
        self._belief.update(pose, view_of_ranges(observed.ranges_m), self._forward_m)
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


@dataclass(frozen=True)
class Baseline:
    """One entry of the list: its `line` says what it does, `sees` what it is shown."""

    line: str
    sees: Sees
    make: Callable[[Config, VisualAct | None], Driver]


BASELINES: dict[str, Baseline] = {
    "random": Baseline("any action that stays on the grid", Sees.NOTHING, lambda config, visual_act: Random()),
    "potential-field": Baseline("the field's direction under the shield, no learning", Sees.CAMERA, PotentialField),
    "astar": Baseline(
        "shortest way over (cell, heading), planned once", Sees.MAP, lambda config, visual_act: AStar(config)
    ),
    "astar-frontier": Baseline(
        "shortest way on what it has seen so far, planned anew at each step",
        Sees.RANGES,
        lambda config, visual_act: FrontierAStar(config),
    ),
}


def view_of_ranges(ranges_m: np.ndarray) -> View:
    """True distances as a view: each ray's distribution is certain, and nothing is advised."""
    bins = np.searchsorted(RANGE_EDGES_M, ranges_m, side="right") - 1
    bins = np.where(ranges_m >= RANGE_EDGES_M[-1], len(RANGE_EDGES_M) - 1, np.maximum(bins, 0))
    certain = np.eye(len(RANGE_EDGES_M), dtype=np.float32)[bins]
    nothing = np.zeros(3, dtype=np.float32)
    return View(nothing, nothing, nothing, certain, RANGE_ANGLES_RAD, RANGE_EDGES_M)
