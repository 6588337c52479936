"""State features of both levels, relative to the car, without map coordinates.

All of them are measured on the believed map. Path lengths are measured from the car, never from the goal: neither the
planner's cost to go nor the potential field's action is an input. Counts enter as logarithms, which are unbounded, so
that the state of a car that drives in circles keeps changing.
"""

import math
from functools import cache, cached_property

import numpy as np

from zsdist.agent.blocks import GOAL_CHOICE, NEIGHBOURS, Choices
from zsdist.agent.egocentric import (
    ACTION_FEATURES,
    BLOCK_FEATURES,
    DIRECTIONS,
    LONG_PATH_M,
    SIGHT_M,
    Geometry,
    action_features,
    block_features,
    clearances,
    line,
)
from zsdist.agent.options import Option
from zsdist.agent.reward_shaping import path_costs
from zsdist.agent.situation import Situation
from zsdist.planning.grid import Grid
from zsdist.planning.lattice import successors_or_self
from zsdist.types import Action, Level, Mirror

VERSION = 1  # of the features' meaning; recorded transitions of another one are refused
LOW_ACTIONS = len(Action)
HERE_FEATURES = 10  # features of the goal and of the block the car is in
LOW_STATE_SIZE = LOW_ACTIONS * ACTION_FEATURES + 2 * DIRECTIONS + 3 + 8
HIGH_STATE_SIZE = NEIGHBOURS * BLOCK_FEATURES + HERE_FEATURES + DIRECTIONS + 3

_ACTION_SINE = 3  # column of `action_features` whose sign a reflection changes
_BLOCK_SINE = 8  # the same of `block_features`
_FAR_M = 10.0  # unit of the distance to the goal


class StepFeatures:
    """States of both levels at one step, each computed at its first use and then kept.

    Args:
        situation: knowledge of the car.
        options: choices of the high level.
    """

    def __init__(self, situation: Situation, options: Choices) -> None:
        self._situation, self._options = situation, options
        self._high: np.ndarray | None = None
        self._low: np.ndarray | None = None
        self._low_aim: tuple[tuple[float, float], bool] | None = None  # subgoal of `_low`, and whether it is the goal

    @cached_property
    def _rooms(self) -> np.ndarray:
        return measure_rooms(self._situation)

    def high(self) -> np.ndarray:
        """Return the state of the high level, `(HIGH_STATE_SIZE,)` float32."""
        if self._high is None:
            self._high = high_state(self._situation, self._options, self._rooms)
        return self._high

    def low(self, option: Option) -> np.ndarray:
        """Return the state of the low level under an option, `(LOW_STATE_SIZE,)` float32."""
        aim = (option.subgoal, option.seeks_goal)
        if self._low is None or aim != self._low_aim:
            self._low, self._low_aim = low_state(self._situation, *aim, self._rooms), aim
        return self._low


def low_state(situation: Situation, subgoal: tuple[float, float], seeks_goal: bool, rooms: np.ndarray) -> np.ndarray:
    """Return the state of the low level under a subgoal, `(LOW_STATE_SIZE,)` float32.

    Args:
        situation: knowledge of the car.
        subgoal: `(x_m, y_m)` of the subgoal.
        seeks_goal: whether the subgoal is the goal itself.
        rooms: `(2, DIRECTIONS)` metres, from `measure_rooms`.
    """
    grid, state = situation.grid, situation.state
    actions = action_features(
        (situation.blocked, successors_or_self(grid.cells), path_costs(grid)),
        situation.seen,
        situation.visits,
        *state,
        (float(subgoal[0]), float(subgoal[1])),
        _geometry(grid),
    )
    own = situation.visits[state.iy, state.ix]
    here = [
        *_polar(situation, subgoal, SIGHT_M),
        *_polar(situation, situation.goal, _FAR_M),
        float(seeks_goal),
        math.log1p(int(own.sum())),
    ]
    parts = (actions.ravel(), rooms.ravel() / SIGHT_M, situation.advice, here)
    return np.concatenate(parts).astype(np.float32)


def high_state(situation: Situation, options: Choices, rooms: np.ndarray) -> np.ndarray:
    """Return the state of the high level, `(HIGH_STATE_SIZE,)` float32; neighbours in the order of `options`."""
    (x, y), (bx, by), goal = situation.position, situation.block, situation.goal
    geometry, heading_rad = _geometry(situation.grid), situation.state.heading * math.pi / 4
    fine_cells = (situation.occupied, situation.seen)
    # The distances are computed here, since compiled code rounds a hypotenuse differently.
    points = [*options.subgoals.tolist(), (x, y)]
    beeline_m = np.array([math.hypot(goal[0] - point_x, goal[1] - point_y) for point_x, point_y in points])
    goal_m = float(beeline_m[-1])
    neighbours, own_seen = block_features(
        (options.exists, options.mask, options.blocks, options.subgoals, options.onward),
        beeline_m,
        fine_cells,
        (situation.block_visits, situation.tries.blocks),
        situation.drive_m,
        (x, y, heading_rad),
        (bx, by),
        geometry,
    )
    here = [
        *_polar(situation, goal, _FAR_M),
        float(tuple(options.blocks[GOAL_CHOICE]) == (bx, by)),
        (min(float(situation.drive_m[situation.goals].min(initial=np.inf)), goal_m + LONG_PATH_M) - goal_m) / SIGHT_M,
        *line(fine_cells, x, y, *goal, *geometry[2:4]),
        math.log1p(situation.tries.goal),
        math.log1p(int(situation.block_visits[by, bx])),
        own_seen,
    ]
    parts = (neighbours.ravel(), here, rooms[0] / SIGHT_M, situation.advice)
    return np.concatenate(parts).astype(np.float32)


def measure_rooms(situation: Situation) -> np.ndarray:
    """Return clearances and distances to unseen ground around the car, `(2, DIRECTIONS)` metres."""
    grid, (x, y) = situation.grid, situation.position
    heading_rad = situation.state.heading * math.pi / 4
    half_arena_m, half_grid_m = grid.arena_m / 2, grid.side_m / 2
    return clearances(situation.occupied, situation.seen, x, y, heading_rad, half_arena_m, half_grid_m, grid.fine_m)


@cache
def _geometry(grid: Grid) -> Geometry:
    return grid.cell_size_m, grid.side_m / 2, grid.arena_m / 2, grid.fine_m, grid.fine_border


def mirror(level: Level) -> Mirror:
    """Return the left-right reflection of a level's states and actions."""
    turn = (-np.arange(DIRECTIONS)) % DIRECTIONS
    advice = np.array([0, 2, 1])
    if level is Level.LOW:
        actions = np.array([0, 2, 1, 4, 3])
        blocks = [
            (actions, ACTION_FEATURES, (_ACTION_SINE,)),
            (turn, 1, ()),
            (turn, 1, ()),
            (advice, 1, ()),
            (np.array([0]), 8, (1, 4)),
        ]
    else:
        actions = np.append((-np.arange(NEIGHBOURS)) % NEIGHBOURS, GOAL_CHOICE)
        blocks = [
            (actions[:NEIGHBOURS], BLOCK_FEATURES, (_BLOCK_SINE,)),
            (np.array([0]), HERE_FEATURES, (1,)),
            (turn, 1, ()),
            (advice, 1, ()),
        ]
    index: list[int] = []
    sign: list[float] = []
    start = 0
    for order, width, odd in blocks:
        one = np.ones(width, np.float32)
        one[list(odd)] = -1
        for source in order:
            index.extend(start + source * width + np.arange(width))
            sign.extend(one)
        start += len(order) * width
    return Mirror(np.array(index), np.array(sign, np.float32), actions)


def _polar(situation: Situation, point: tuple[float, float], scale_m: float) -> tuple[float, float, float]:
    (x, y), heading = situation.position, situation.state.heading * math.pi / 4
    bearing = math.atan2(point[1] - y, point[0] - x) - heading
    return math.cos(bearing), math.sin(bearing), math.hypot(point[0] - x, point[1] - y) / scale_m
