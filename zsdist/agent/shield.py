"""The shield: masks what would hit believed-occupied space or end where no free way leads on. It never chooses."""

from functools import cache
from typing import NamedTuple

import numba
import numpy as np

from zsdist.agent import reach
from zsdist.planning.belief import BeliefMap
from zsdist.planning.footprint import ACTIONS, MARGIN_M, FootprintTable, successor
from zsdist.planning.grid import Grid
from zsdist.planning.lattice import successors
from zsdist.planning.shortest_path import live_states
from zsdist.types import Action, LatticeState

WARY_M = 2.2
HIDING_SQUARES = 3  # unseen ground that is nowhere farther from seen ground is a sliver, in which no obstacle hides
NEAR_CELLS = 3  # where the car may have to squeeze out
_IN_PLACE = (Action.TURN_LEFT_90, Action.TURN_RIGHT_90)


class Reading(NamedTuple):
    """How carefully the belief is read.

    Attributes:
        margin_m: about the car's box.
        above: log-odds from which a square counts as occupied.
        wary: whether unseen ground within the reach of one action counts as occupied, all but slivers.
        deep: of that ground only what is not next to seen ground.
    """

    margin_m: float
    above: float
    wary: bool = False
    deep: bool = False


USUAL, DOUBTFUL = Reading(MARGIN_M, 0.0), Reading(0.0, 0.7)
CAREFUL, CLOSE, CLOSER = USUAL._replace(wary=True), Reading(0.0, 0.0, wary=True), DOUBTFUL._replace(wary=True)
# The reading about the car and that of the rest. What is not seen from here is doubted before unseen ground is entered.
CAREFUL_RUNGS = (
    (CAREFUL, USUAL),
    (CLOSE, USUAL),
    (CLOSER, USUAL),
    (CAREFUL, DOUBTFUL),
    (CLOSE, DOUBTFUL),
    (CLOSER, DOUBTFUL),
)
DARING_RUNGS = (
    *((near._replace(deep=True), far) for near, far in CAREFUL_RUNGS),
    (USUAL, USUAL),
    (USUAL, DOUBTFUL),
    (DOUBTFUL, DOUBTFUL),
    (Reading(-0.08, 1.4), DOUBTFUL),  # squares that are touched rather than covered add as much again
)


class Judgement(NamedTuple):
    """What the shield makes of the belief.

    Attributes:
        blocked: `(cells, cells, 8, 5)` bool, actions that are not to be taken: they hit something, leave the grid, or
            end where no free way leads on.
        allowed: `(5,)` bool, what the car may do now. Where everything is blocked, what hits nothing; then turns in
            place.
        forced: whether everything was blocked.
        gave_way: whether full care leaves the car no way to the goal.
    """

    blocked: np.ndarray
    allowed: np.ndarray
    forced: bool
    gave_way: bool


def judge(belief: BeliefMap, state: LatticeState, goals: np.ndarray, visits: np.ndarray) -> Judgement:
    """The most careful reading of the belief under which a way leads from the car to the goal.

    The belief errs, and the car has no reverse gear: with one fixed reading it is sooner or later walled in by what is
    not there. Where none of the careful readings leads to the goal for want of having seen enough, the car turns to
    where it has not looked yet before it enters unseen ground. Where no reading leads to the goal, the usual one holds
    and a state is live from which the car can keep going.

    Args:
        belief: what is occupied and what was seen.
        state: where the car is.
        goals: `(cells, cells)` bool.
        visits: `(cells, cells, 8)`, how often the car was in each state.
    """
    read = cache(lambda reading: _blocked(belief, reading, state))
    window = tuple(slice(max(at - NEAR_CELLS, 0), at + NEAR_CELLS + 1) for at in (state.iy, state.ix))
    here = (state.iy, state.ix, state.heading)
    for near, far in CAREFUL_RUNGS + DARING_RUNGS:
        hits = read(far).copy()
        hits[window] = read(near)[window]
        live = reach.states_to(hits, goals)
        if live[here]:
            break
    else:
        hits = read(USUAL)
        live = live_states(hits)
    judgement = _judgement(hits, live, state, (near, far) != CAREFUL_RUNGS[0])
    unseen_matters = (read(CAREFUL)[window] != read(USUAL)[window]).any()
    if (near, far) in DARING_RUNGS and unseen_matters:
        fresh = [not visits[state.iy, state.ix, successor(state, action).heading] for action in range(ACTIONS)]
        looks = ~read(CLOSE)[here] & np.isin(np.arange(ACTIONS), _IN_PLACE) & fresh
        if looks.any():
            judgement.blocked[here] = ~looks
            return judgement._replace(allowed=looks, forced=False)
    return judgement


def on_grid(state: LatticeState, cells: int) -> np.ndarray:
    """Actions that do not leave the grid, `(5,)` bool: masked for every policy."""
    ends = (successor(state, action) for action in range(ACTIONS))
    return np.array([0 <= end.ix < cells and 0 <= end.iy < cells for end in ends])


def _judgement(hits: np.ndarray, live: np.ndarray, state: LatticeState, gave_way: bool) -> Judgement:
    blocked = hits | ~live.ravel()[successors(len(hits))].reshape(hits.shape)  # what leaves the grid is among the hits
    here = (state.iy, state.ix, state.heading)
    allowed = ~blocked[here]
    forced = not allowed.any()
    if forced:
        allowed = ~hits[here]
    if not allowed.any():
        allowed[list(_IN_PLACE)] = True
    return Judgement(blocked, allowed, forced, gave_way)


@cache
def _table(grid: Grid, margin_m: float) -> FootprintTable:
    return FootprintTable(grid, margin_m)


def _blocked(belief: BeliefMap, reading: Reading, state: LatticeState) -> np.ndarray:
    grid = belief.grid
    squares = belief.occupied(reading.above)
    if reading.wary:
        x_m, y_m = grid.centre(state.ix, state.iy)
        place = (x_m + grid.arena_m / 2, y_m + grid.arena_m / 2)
        _add_unseen(squares, belief.seen(), *place, grid.fine_m, 0 if reading.deep else HIDING_SQUARES)
    return _table(grid, reading.margin_m).blocked(squares)


@numba.njit(cache=True)
def _add_unseen(squares, seen, x, y, square, span):  # noqa: ANN001, ANN202
    """Marks unseen ground within `WARY_M` of the car in `squares`, but no slivers, in which nothing can hide.

    Args:
        squares: `(fine_size, fine_size)` bool, changed.
        seen: `(fine_size, fine_size)` bool.
        x: of the car, metres from the frame's corner.
        y: of the car, metres from the frame's corner.
        square: side of a fine square.
        span: how far about ground that is deep in the unseen, in squares, the marks reach.
    """
    size = squares.shape[0]
    reach = int(WARY_M / square) + 1
    at_x, at_y = int(x / square), int(y / square)
    left, right = max(at_x - reach, 0), min(at_x + reach + 1, size)
    bottom, top = max(at_y - reach, 0), min(at_y + reach + 1, size)
    for fy in range(max(bottom - span, 0), min(top + span, size)):
        for fx in range(max(left - span, 0), min(right + span, size)):
            if seen[fy, fx] or _any_near(seen, fx, fy):
                continue
            # Deep in the unseen: an obstacle may be here, and reach as far as the seen ground about it.
            for dy in range(-span, span + 1):
                for dx in range(abs(dy) - span, span + 1 - abs(dy)):
                    ny, nx = fy + dy, fx + dx
                    if not (bottom <= ny < top and left <= nx < right) or seen[ny, nx]:
                        continue
                    if ((nx + 0.5) * square - x) ** 2 + ((ny + 0.5) * square - y) ** 2 < WARY_M**2:
                        squares[ny, nx] = True


@numba.njit(cache=True)
def _any_near(seen, fx, fy):  # noqa: ANN001, ANN202
    for dy in range(-HIDING_SQUARES, HIDING_SQUARES + 1):
        span = HIDING_SQUARES - abs(dy)
        if 0 <= fy + dy < seen.shape[0]:
            for dx in range(-span, span + 1):
                if 0 <= fx + dx < seen.shape[1] and seen[fy + dy, fx + dx]:
                    return True
    return False
