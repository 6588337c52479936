"""The states of both levels, relative to the car: no coordinate of the map is among them.

Everything is measured on the believed map. Ways are measured from the car, never from the goal: the cost to go to it,
by which the planner decides, is no input, and neither is the potential field's choice. What is counted enters by its
logarithm, which has no upper end: a car that goes in circles never comes to look as it did before.
"""

import math

import numpy as np

from zsdist.agent.blocks import GOAL_CHOICE, NEIGHBOURS, Choices
from zsdist.agent.egocentric import (
    ACTION_FEATURES,
    BLOCK_FEATURES,
    DIRECTIONS,
    LONG_WAY_M,
    SIGHT_M,
    action_features,
    block_features,
    block_shares,
    clearances,
    line,
)
from zsdist.agent.reward_shaping import way_costs
from zsdist.agent.situation import Situation
from zsdist.planning.grid import FINE_PER_CELL
from zsdist.planning.lattice import successors_or_self
from zsdist.types import Action, Level, Mirror

LOW_ACTIONS = len(Action)
HERE_FEATURES = 10  # of the goal and of the block the car is in
LOW_STATE_SIZE = LOW_ACTIONS * ACTION_FEATURES + 2 * DIRECTIONS + 3 + 8
HIGH_STATE_SIZE = NEIGHBOURS * BLOCK_FEATURES + HERE_FEATURES + DIRECTIONS + 3

_ACTION_SINE = 3  # column of `action_features` that a reflection turns round
_BLOCK_SINE = 8  # column of `block_features`
_FAR_M = 10.0


def low_state(situation: Situation, subgoal: tuple[float, float], seeks_goal: bool, rooms: np.ndarray) -> np.ndarray:
    """State of the low level under a subgoal, `(LOW_STATE_SIZE,)` float32.

    Args:
        situation: what the car knows.
        subgoal: `(x_m, y_m)`.
        seeks_goal: whether the subgoal is the goal itself.
        rooms: of `measure_rooms`.
    """
    grid, state = situation.grid, situation.state
    actions = action_features(
        situation.blocked,
        successors_or_self(grid.cells),
        way_costs(grid),
        situation.seen,
        situation.visits,
        *state,
        float(subgoal[0]),
        float(subgoal[1]),
        grid.cell_size_m,
        grid.side_m / 2,
        grid.fine_border,
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
    """State of the high level, `(HIGH_STATE_SIZE,)` float32; neighbours in the order of `options`."""
    grid, (x, y) = situation.grid, situation.place
    bx, by = situation.block
    goal_m = math.hypot(situation.goal[0] - x, situation.goal[1] - y)
    side = grid.block_size * FINE_PER_CELL
    seen, occupied = (
        block_shares(fine_cells, grid.fine_border, side, grid.blocks, bx, by)
        for fine_cells in (situation.seen, situation.occupied)
    )
    neighbours = _block_features(situation, options, goal_m, seen, occupied)
    here = [
        *_polar(situation, situation.goal, _FAR_M),
        float(tuple(options.blocks[GOAL_CHOICE]) == (bx, by)),
        (min(float(situation.drive_m[situation.goals].min(initial=np.inf)), goal_m + LONG_WAY_M) - goal_m) / SIGHT_M,
        *_line(situation, situation.goal),
        math.log1p(situation.goal_tries),
        math.log1p(int(situation.block_visits[by, bx])),
        float(seen[by, bx]),
    ]
    parts = (neighbours.ravel(), here, rooms[0] / SIGHT_M, situation.advice)
    return np.concatenate(parts).astype(np.float32)


def measure_rooms(situation: Situation) -> np.ndarray:
    """Clearances and distances to the unseen about the car, `(2, DIRECTIONS)` metres."""
    grid, (x, y) = situation.grid, situation.place
    heading = situation.state.heading * math.pi / 4
    return clearances(situation.occupied, situation.seen, x, y, heading, grid.arena_m / 2, grid.side_m / 2, grid.fine_m)


def mirror(level: Level) -> Mirror:
    """The left-right reflection of a level's states and actions."""
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
    index, sign, start = [], [], 0
    for order, width, odd in blocks:
        one = np.ones(width, np.float32)
        one[list(odd)] = -1
        for source in order:
            index.extend(start + source * width + np.arange(width))
            sign.extend(one)
        start += len(order) * width
    return Mirror(np.array(index), np.array(sign, np.float32), actions)


def _block_features(
    situation: Situation, options: Choices, goal_m: float, seen: np.ndarray, occupied: np.ndarray
) -> np.ndarray:
    """`(NEIGHBOURS, BLOCK_FEATURES)`; all 0 of a block that is not there."""
    grid, (x, y), (goal_x, goal_y) = situation.grid, situation.place, situation.goal
    # Here, since compiled code rounds a hypotenuse in another way.
    on_m = np.array([math.hypot(goal_x - sub_x, goal_y - sub_y) for sub_x, sub_y in options.subgoals.tolist()])
    return block_features(
        options.exists,
        options.mask,
        options.blocks,
        options.subgoals,
        options.onward,
        on_m,
        goal_m,
        seen,
        occupied,
        situation.block_visits,
        situation.tries,
        situation.drive_m,
        situation.occupied,
        situation.seen,
        x,
        y,
        situation.state.heading * math.pi / 4,
        grid.cell_size_m,
        grid.side_m / 2,
        grid.arena_m / 2,
        grid.fine_m,
    )


def _polar(situation: Situation, point: tuple[float, float], scale_m: float) -> tuple[float, float, float]:
    (x, y), heading = situation.place, situation.state.heading * math.pi / 4
    bearing = math.atan2(point[1] - y, point[0] - x) - heading
    return math.cos(bearing), math.sin(bearing), math.hypot(point[0] - x, point[1] - y) / scale_m


def _line(situation: Situation, point: tuple[float, float]) -> tuple[float, float]:
    grid = situation.grid
    return line(situation.occupied, situation.seen, *situation.place, *point, grid.arena_m / 2, grid.fine_m)
