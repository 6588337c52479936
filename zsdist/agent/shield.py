"""The shield: masks what would hit believed-occupied space or end where no free way leads on. It never chooses."""

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numba
import numpy as np

from zsdist.agent import reach
from zsdist.planning.belief import BeliefMap
from zsdist.planning.footprint import ACTIONS, MARGIN_M, FootprintTable, successor
from zsdist.planning.grid import Grid
from zsdist.planning.shortest_path import live_states
from zsdist.types import Action, LatticeState

WARY_M = 2.2  # how far from its centre the car reaches in one action
HIDING_SQUARES = 3  # an obstacle does not hide in unseen ground this close to seen ground
NEAR_CELLS = 3  # where the car may have to squeeze out
_IN_PLACE = (Action.TURN_LEFT_90, Action.TURN_RIGHT_90)


class Rung(NamedTuple):
    """How careful a reading of the belief is.

    Attributes:
        margin_m: about the car's box.
        above: log-odds from which a square counts as occupied.
        wary: whether unseen ground within the reach of one action counts as occupied.
        near: whether it holds about the car only, the usual reading elsewhere.
    """

    margin_m: float
    above: float
    wary: bool = False
    near: bool = False


USUAL = Rung(MARGIN_M, 0.0)
RUNGS = (
    Rung(MARGIN_M, 0.0, wary=True),
    Rung(0.0, 0.0, wary=True, near=True),
    Rung(0.0, 0.7, wary=True, near=True),
    USUAL,
    Rung(0.0, 0.0, near=True),
    Rung(0.0, 0.7, near=True),
    Rung(0.0, 0.7),
    Rung(-0.08, 1.4, near=True),  # squares that are touched rather than covered add as much again
)


@dataclass(frozen=True)
class Judgement:
    """What the shield makes of the belief.

    Attributes:
        blocked: `(cells, cells, 8, 5)` bool, actions that are not to be taken.
        live: `(cells, cells, 8)` bool, states with a believed-safe way on.
        gave_way: whether full care leaves the car no way to the goal.
    """

    blocked: np.ndarray
    live: np.ndarray
    gave_way: bool


def judge(belief: BeliefMap, state: LatticeState, goals: np.ndarray) -> Judgement:
    """The most careful reading of the belief under which a way leads from the car to the goal.

    The belief errs, and the car has no reverse gear: with one fixed reading it is sooner or later walled in by what is
    not there. Where no reading leads to the goal, the usual one holds and a state is live from which the car can keep
    going.

    Args:
        belief: what is occupied and what was seen.
        state: where the car is.
        goals: `(cells, cells)` bool.
    """
    usual = cache(lambda: _blocked(belief, USUAL, state))
    for index, rung in enumerate(RUNGS):
        blocked = usual() if rung is USUAL else _blocked(belief, rung, state)
        if rung.near:
            window = tuple(slice(max(at - NEAR_CELLS, 0), at + NEAR_CELLS + 1) for at in (state.iy, state.ix))
            near, blocked = blocked[window], usual().copy()
            blocked[window] = near
        live = reach.states_to(blocked, goals)
        if live[state.iy, state.ix, state.heading]:
            return Judgement(blocked, live, index > 0)
    return Judgement(usual(), live_states(usual()), True)


def on_grid(state: LatticeState, cells: int) -> np.ndarray:
    """Actions that do not leave the grid, `(5,)` bool: masked for every policy."""
    ends = (successor(state, action) for action in range(ACTIONS))
    return np.array([0 <= end.ix < cells and 0 <= end.iy < cells for end in ends])


def mask(blocked: np.ndarray, live: np.ndarray, state: LatticeState) -> tuple[np.ndarray, bool]:
    """Actions that the shield allows, `(5,)` bool, and whether it had to give way.

    Where no action passes, those that are not blocked; then turns in place.
    """
    free = ~blocked[state.iy, state.ix, state.heading]
    ends = [successor(state, action) for action in range(ACTIONS)]
    safe = np.array([ok and live[end.iy, end.ix, end.heading] for ok, end in zip(free, ends, strict=True)])
    if safe.any():
        return safe, False
    if free.any():
        return free, True
    turns = np.zeros(ACTIONS, bool)
    turns[list(_IN_PLACE)] = True
    return turns, True


@cache
def _table(grid: Grid, margin_m: float) -> FootprintTable:
    return FootprintTable(grid, margin_m)


def _blocked(belief: BeliefMap, rung: Rung, state: LatticeState) -> np.ndarray:
    grid = belief.grid
    squares = belief.occupied(rung.above)
    if rung.wary:
        x_m, y_m = grid.centre(state.ix, state.iy)
        _add_unseen(squares, belief.seen(), x_m + grid.arena_m / 2, y_m + grid.arena_m / 2, grid.fine_m)
    return _table(grid, rung.margin_m).blocked(squares)


@numba.njit(cache=True)
def _add_unseen(squares, seen, x, y, square):  # noqa: ANN001, ANN202
    """Marks unseen ground within `WARY_M` of the car in `squares`, but not the seam of what was seen.

    Args:
        squares: `(fine_size, fine_size)` bool, changed.
        seen: `(fine_size, fine_size)` bool.
        x: of the car, metres from the frame's corner.
        y: of the car, metres from the frame's corner.
        square: side of a fine square.
    """
    size = squares.shape[0]
    reach = int(WARY_M / square) + 1
    at_x, at_y = int(x / square), int(y / square)
    for fy in range(max(at_y - reach, 0), min(at_y + reach + 1, size)):
        for fx in range(max(at_x - reach, 0), min(at_x + reach + 1, size)):
            if seen[fy, fx] or ((fx + 0.5) * square - x) ** 2 + ((fy + 0.5) * square - y) ** 2 >= WARY_M**2:
                continue
            hidden = True
            for dy in range(-HIDING_SQUARES, HIDING_SQUARES + 1):
                span = HIDING_SQUARES - abs(dy)
                if 0 <= fy + dy < size:
                    for dx in range(-span, span + 1):
                        if 0 <= fx + dx < size and seen[fy + dy, fx + dx]:
                            hidden = False
            if hidden:
                squares[fy, fx] = True
