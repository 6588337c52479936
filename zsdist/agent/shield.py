"""Shield: mask over actions that would hit something on the belief map or end without a free path; never a choice."""

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

HIDING_CELLS = 3  # fine cells; unseen ground nowhere farther than this from seen ground is a sliver without obstacle
_IN_PLACE = (Action.TURN_LEFT_90, Action.TURN_RIGHT_90)
_ALONG_SIDES = slice(None, None, 2)  # headings along the grid's sides; turns in place through all four are a full turn


class Caution(NamedTuple):
    """Care with which the belief map is read.

    Attributes:
        margin_m: margin around the car's box that must be free.
        above: log-odds from which a fine cell counts as occupied.
        unseen: whether unseen ground counts as occupied, except for slivers.
        deep: whether unseen ground next to seen ground is excepted too.
    """

    margin_m: float
    above: float
    unseen: bool = False
    deep: bool = False


class Rung(NamedTuple):
    """Degree of care, one of a list from full care to daring.

    Attributes:
        near: care at states that the car has visited, and from which it has therefore observed.
        far: care at every other state. Unseen ground is free there, since the car will have observed it before it
            drives on from such a state.
        returning: whether the car may move only to states from which it can turn round or reach the goal with the care
            `near`.
    """

    near: Caution
    far: Caution
    returning: bool


# Seen from afar, a surface is smeared over up to a metre until nearer views correct it. A threshold at even odds would
# close too much ground until then.
_LIKELY, _SURE, _SURER = 0.25, 0.95, 1.65
USUAL, DOUBTFUL = Caution(MARGIN_M, _LIKELY), Caution(0.0, _SURE)
CAREFUL, CLOSE, CLOSER = USUAL._replace(unseen=True), Caution(0.0, _LIKELY, unseen=True), DOUBTFUL._replace(unseen=True)
CAREFUL_RUNGS = tuple(
    Rung(near, far, returning)
    for returning, far, near in product((True, False), (USUAL, DOUBTFUL), (CAREFUL, CLOSE, CLOSER))
)
# Care at states without observation is lowered before unseen ground is entered.
DARING_RUNGS = (
    *(
        Rung(near._replace(deep=True), far, returning=False)
        for far, near in product((USUAL, DOUBTFUL), (CAREFUL, CLOSE, CLOSER))
    ),
    Rung(USUAL, USUAL, returning=False),
    Rung(USUAL, DOUBTFUL, returning=False),
    Rung(DOUBTFUL, DOUBTFUL, returning=False),
    # fine cells that the box only touches count as covered, which adds as much again
    Rung(Caution(-0.08, _SURER), DOUBTFUL, returning=False),
)


class Judgement(NamedTuple):
    """Blocked moves and allowed actions on the present belief map.

    Attributes:
        moves: blocked moves, which hit something, leave the grid, or end where no free path leads on.
        allowed: `(5,)` bool, actions that the car may take now. If all are blocked, these are the actions that hit
            nothing; if there are none, the turns in place.
        forced: whether all actions were blocked.
        stuck: whether each of them hits something, the turns in place too.
        gave_way: whether full care leaves the car no path to the goal.
    """

    moves: BlockedMoves
    allowed: np.ndarray
    forced: bool
    stuck: bool
    gave_way: bool


def judge(belief: BeliefMap, state: LatticeState, goals: np.ndarray, visits: np.ndarray) -> Judgement:
    """Return the judgement of the most careful rung under which a path leads from the car to the goal.

    The belief map has errors, and the car has no reverse gear: under one fixed rung it would sooner or later be walled
    in by obstacles that do not exist. The rungs are therefore tried from the most careful one on. As long as one of
    `CAREFUL_RUNGS` leaves a path to the goal, the car moves on seen ground only, and if possible only to states from
    which it can turn round. Actions at states that it has not visited are judged as if it had observed from there.
    Where a view is missing, it therefore turns in place to observe before it enters unseen ground. If no rung leaves a
    path to the goal, the care is `USUAL`, and a state is viable if the car can keep moving from it.

    Args:
        belief: occupied and seen ground.
        state: lattice state of the car.
        goals: `(cells, cells)` bool, cells in which the goal is reached.
        visits: `(cells, cells, 8)` int, number of times that the car was in each state, now included.
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
    """Return the actions that do not leave the grid, `(5,)` bool; all others are masked for every policy."""
    ends = (successor(state, action) for action in range(ACTIONS))
    return np.array([0 <= end.ix < cells and 0 <= end.iy < cells for end in ends])


def _judgement(collisions: BlockedMoves, viable: np.ndarray, state: LatticeState, gave_way: bool) -> Judgement:
    blocked = collisions.blocking_exits_from(viable)
    allowed = ~blocked.at_state(state)
    forced = not allowed.any()
    if forced:
        allowed = ~collisions.at_state(state)
    stuck = not allowed.any()
    if stuck:
        allowed[list(_IN_PLACE)] = True
    return Judgement(blocked, allowed, forced, bool(stuck), gave_way)


@cache
def _table(grid: Grid, margin_m: float) -> FootprintTable:
    return FootprintTable(grid, margin_m)


def _collisions(belief: BeliefMap, reading: Caution, occupied: np.ndarray) -> BlockedMoves:
    if reading.unseen:
        occupied = occupied | _hiding_cells(bitmaps.pack_rows(belief.seen()), reading.deep)
    return BlockedMoves.from_occupancy(occupied, _table(belief.grid, reading.margin_m))


def _hiding_cells(seen: np.ndarray, deep: bool) -> np.ndarray:
    """Return the unseen fine cells that may hide an obstacle: the morphological opening of the unseen ground.

    With `deep` it is the erosion, which leaves out cells next to seen ground.
    """
    return (bitmaps.erosion if deep else bitmaps.opening)(~seen, HIDING_CELLS)


def _returning(collisions: BlockedMoves, goals: np.ndarray) -> BlockedMoves:
    """Block also the moves after which no free path leads to the goal or to a cell in which the car can turn round."""
    about = ~np.bitwise_or.reduce(collisions.words[_ALONG_SIDES, Action.TURN_LEFT_90])
    back = collisions.blocking_exits_from(collisions.states_reaching(goals | about))
    back.words[:, _IN_PLACE] = collisions.words[:, _IN_PLACE]
    return back
