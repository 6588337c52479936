"""The shield: masks what would hit believed-occupied space or end where no free way leads on. It never chooses."""

from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np

from zsdist.planning import bitmaps, reachability
from zsdist.planning.belief import BeliefMap
from zsdist.planning.footprint import ACTIONS, MARGIN_M, FootprintTable, successor
from zsdist.planning.grid import Grid
from zsdist.planning.reachability import BlockedMoves
from zsdist.planning.shortest_path import viable_states
from zsdist.types import Action, LatticeState

HIDING_CELLS = 3  # unseen ground that is nowhere farther from seen ground is a sliver, in which no obstacle hides
_IN_PLACE = (Action.TURN_LEFT_90, Action.TURN_RIGHT_90)
_SQUARE_ON = slice(None, None, 2)  # headings along the grid's sides; a turn in place through all four is a full one


class Caution(NamedTuple):
    """How carefully the belief is read.

    Attributes:
        margin_m: about the car's box.
        above: log-odds from which a square counts as occupied.
        unseen: whether unseen ground counts as occupied, all but slivers.
        deep: of that ground only what is not next to seen ground.
    """

    margin_m: float
    above: float
    unseen: bool = False
    deep: bool = False


class Rung(NamedTuple):
    """One step of the ladder from full care to daring.

    Attributes:
        near: how the belief is read where the car has been, and so has looked from.
        far: how it is read of every other state. Unseen ground is free there: the car will have looked before it
            drives on from such a state.
        returning: whether the car may move on only to where, as `near` reads the belief, it can turn round or arrive.
    """

    near: Caution
    far: Caution
    returning: bool


# From afar a surface is smeared over as much as a metre. Until nearer looks wear it away, even odds close too much.
_LIKELY, _SURE, _SURER = 0.25, 0.95, 1.65
USUAL, DOUBTFUL = Caution(MARGIN_M, _LIKELY), Caution(0.0, _SURE)
CAREFUL, CLOSE, CLOSER = USUAL._replace(unseen=True), Caution(0.0, _LIKELY, unseen=True), DOUBTFUL._replace(unseen=True)
CAREFUL_RUNGS = tuple(
    Rung(near, far, returning)
    for returning, far, near in product((True, False), (USUAL, DOUBTFUL), (CAREFUL, CLOSE, CLOSER))
)
# What is not seen from here is doubted before unseen ground is entered.
DARING_RUNGS = (
    *(
        Rung(near._replace(deep=True), far, returning=False)
        for far, near in product((USUAL, DOUBTFUL), (CAREFUL, CLOSE, CLOSER))
    ),
    Rung(USUAL, USUAL, returning=False),
    Rung(USUAL, DOUBTFUL, returning=False),
    Rung(DOUBTFUL, DOUBTFUL, returning=False),
    # squares that are touched rather than covered add as much again
    Rung(Caution(-0.08, _SURER), DOUBTFUL, returning=False),
)


class Judgement(NamedTuple):
    """What the shield makes of the belief.

    Attributes:
        moves: what is blocked: it hits something, leaves the grid, or ends where no free way leads on.
        allowed: `(5,)` bool, what the car may do now. Where everything is blocked, what hits nothing; then turns in
            place.
        forced: whether everything was blocked.
        gave_way: whether full care leaves the car no way to the goal.
    """

    moves: BlockedMoves
    allowed: np.ndarray
    forced: bool
    gave_way: bool


def judge(belief: BeliefMap, state: LatticeState, goals: np.ndarray, visits: np.ndarray) -> Judgement:
    """The most careful reading of the belief under which a way leads from the car to the goal.

    The belief errs, and the car has no reverse gear: with one fixed reading it is sooner or later walled in by what is
    not there. So the readings are tried from the most careful on. As long as one of the careful ones leads to the
    goal, the car moves on seen ground only, and only to where it can turn about; what it may do in a state in which it
    has not been yet is judged as if it had looked about there. So it turns in place to look, where that is what is
    missing, before it dares to enter unseen ground. Where no reading leads to the goal, the usual one holds and a
    state is live from which the car can keep going.

    Args:
        belief: what is occupied and what was seen.
        state: where the car is.
        goals: `(cells, cells)` bool.
        visits: `(cells, cells, 8)`, how often the car was in each state, this time included.
    """
    goal_cells, visited_states = reachability.pack_cells(goals), reachability.pack_states(visits > 0)
    occupied = cache(lambda above: bitmaps.pack_rows(belief.occupied(above)))
    read = cache(lambda reading: _collisions(belief, reading, occupied(reading.above)))
    cautious = cache(lambda near, returning: _returning(read(near), goal_cells) if returning else read(near))
    for rung in CAREFUL_RUNGS + DARING_RUNGS:
        collisions = cautious(rung.near, rung.returning).where(visited_states, read(rung.far))
        viable = collisions.states_reaching(goal_cells)
        if reachability.contains_state(viable, state):
            break
    else:
        collisions = read(USUAL)
        viable = reachability.pack_states(viable_states(collisions.blocked))
    return _judgement(collisions, viable, state, rung != CAREFUL_RUNGS[0])


def on_grid(state: LatticeState, cells: int) -> np.ndarray:
    """Actions that do not leave the grid, `(5,)` bool: masked for every policy."""
    ends = (successor(state, action) for action in range(ACTIONS))
    return np.array([0 <= end.ix < cells and 0 <= end.iy < cells for end in ends])


def _judgement(collisions: BlockedMoves, viable: np.ndarray, state: LatticeState, gave_way: bool) -> Judgement:
    blocked = collisions.blocking_exits_from(viable)
    allowed = ~blocked.at_state(state)
    forced = not allowed.any()
    if forced:
        allowed = ~collisions.at_state(state)
    if not allowed.any():
        allowed[list(_IN_PLACE)] = True
    return Judgement(blocked, allowed, forced, gave_way)


@cache
def _table(grid: Grid, margin_m: float) -> FootprintTable:
    return FootprintTable(grid, margin_m)


def _collisions(belief: BeliefMap, reading: Caution, occupied: np.ndarray) -> BlockedMoves:
    if reading.unseen:
        occupied = occupied | _hiding_cells(bitmaps.pack_rows(belief.seen()), reading.deep)
    return BlockedMoves.from_occupancy(occupied, _table(belief.grid, reading.margin_m))


def _hiding_cells(seen: np.ndarray, deep: bool) -> np.ndarray:
    """Unseen squares in which an obstacle may be: within `HIDING_CELLS` of unseen ground that seen ground is not."""
    return (bitmaps.erosion if deep else bitmaps.opening)(~seen, HIDING_CELLS)


def _returning(collisions: BlockedMoves, goals: np.ndarray) -> BlockedMoves:
    """The collisions, and moves to where no free way leads to the goal or to a cell in which the car can turn about."""
    about = ~np.bitwise_or.reduce(collisions.words[_SQUARE_ON, Action.TURN_LEFT_90])
    back = collisions.blocking_exits_from(collisions.states_reaching(goals | about))
    back.words[:, _IN_PLACE] = collisions.words[:, _IN_PLACE]
    return back
