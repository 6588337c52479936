"""Shortest ways over (cell, heading), and the states from which the car can keep going.

Both start from `blocked`, `[iy, ix, heading, action]` `(cells, cells, 8, 5)` bool, of `FootprintTable.blocked`. The
car has no reverse gear, so the graph is directed: costs to go are found from the goal against the direction of travel.
"""

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numba import njit

from zsdist.planning.footprint import ACTIONS, ADVANCES, TURNS
from zsdist.planning.grid import HEADINGS, STEPS, Grid
from zsdist.planning.lattice import flat_state, lattice_state, predecessors, successors
from zsdist.types import Action, LatticeState

STEPS_COST = np.ones((HEADINGS, ACTIONS))  # cost of each action from each heading, counted in actions
_ACTION_TIE_M = 1e-3  # an action's cost on top of its metres: of equally long ways the one of fewer actions wins,
_TURN_TIE_M = 2e-4  # and of those the one that turns through fewer eighths

_ENDS = (np.arange(HEADINGS)[:, None] + np.array(TURNS)) % HEADINGS
_ADVANCED = np.hypot(STEPS[_ENDS, 0], STEPS[_ENDS, 1]) * ADVANCES  # by heading before the action, in sides of a cell


class Path(NamedTuple):
    """A way: `states` from the start to the goal, and the `actions` between them, one fewer."""

    states: list[LatticeState]
    actions: list[Action]


def metres_cost(grid: Grid) -> np.ndarray:
    """Cost of each action from each heading, `(8, 5)` float64: metres driven, and about a millimetre for the action.

    The millimetre prefers fewer actions and fewer turns among ways of equal length and keeps turns in place from being
    free; `length_m` gives a way's length without it.
    """
    return _ADVANCED * grid.cell_size_m + _ACTION_TIE_M + _TURN_TIE_M * np.abs(TURNS)


METRES = metres_cost(Grid())  # of the default grid


def goal_mask(grid: Grid, goal_xy: tuple[float, float], radius_m: float) -> np.ndarray:
    """Cells whose centre is within `radius_m` of the goal, `[iy, ix]` `(cells, cells)` bool."""
    xs, ys = grid.cell_centres()
    return np.hypot(xs[None, :] - goal_xy[0], ys[:, None] - goal_xy[1]) <= radius_m


def cost_to_go(
    blocked: np.ndarray, goals: np.ndarray, action_costs: np.ndarray, until: Collection[LatticeState] = ()
) -> np.ndarray:
    """Least cost from every state to a goal cell, whatever the heading there.

    Args:
        blocked: `(cells, cells, 8, 5)` bool.
        goals: `[iy, ix]` `(cells, cells)` bool.
        action_costs: `(8, 5)`, by heading before the action, above 0; `METRES` or `STEPS_COST`.
        until: where the costs of these states, and along the ways from them, are enough; none: of all states.

    Returns:
        `[iy, ix, heading]` `(cells, cells, 8)` float32; infinite where no goal cell can be reached, and where it was
        not needed for `until`.

    Raises:
        ValueError: an action costs nothing or less.
    """
    if not np.min(action_costs) > 0:
        raise ValueError(f"the least action cost is {np.min(action_costs)}; allowed is above 0")
    cells = len(blocked)
    enough = np.array([flat_state(state, cells) for state in until], np.int32)
    costs = np.asarray(action_costs, dtype=np.float64)
    field = _search(blocked.ravel(), goals.ravel(), costs, predecessors(cells), enough)
    return field.reshape(cells, cells, HEADINGS)


def path(cost: np.ndarray, blocked: np.ndarray, start: LatticeState, action_costs: np.ndarray) -> Path:
    """The way that a field of `cost_to_go` describes, from `start`.

    Args:
        cost: `(cells, cells, 8)`, made with the same `blocked` and `action_costs`.
        blocked: `(cells, cells, 8, 5)` bool.
        start: where the way begins.
        action_costs: `(8, 5)`.

    Raises:
        ValueError: no goal cell can be reached from `start`, or the field is of another `blocked`.
    """
    flat, actions = flat_path(cost, blocked, start, action_costs)
    states = [lattice_state(state, len(blocked)) for state in flat.tolist()]
    return Path(states, [Action(action) for action in actions.tolist()])


def flat_path(
    cost: np.ndarray, blocked: np.ndarray, start: LatticeState, action_costs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`path` as the flat states and the numbers of the actions, both int."""
    if not math.isfinite(cost[start.iy, start.ix, start.heading]):
        raise ValueError(f"no way leads from {start} to the goal")
    cells = len(blocked)
    flat, actions, arrived = _follow(
        cost.ravel(), blocked.ravel(), action_costs, successors(cells), flat_state(start, cells)
    )
    if not arrived:
        last = lattice_state(int(flat[-1]), cells)
        raise ValueError(f"every action from {last} is blocked; the costs belong to another map")
    return flat, actions


def length_m(states: list[LatticeState], cell_size_m: float) -> float:
    """Metres driven along a way; turns in place add nothing."""
    cells = np.array([(state.ix, state.iy) for state in states]).reshape(-1, 2)
    return float(np.hypot(*np.diff(cells, axis=0).T).sum() * cell_size_m)


def live_states(blocked: np.ndarray) -> np.ndarray:
    """States from which the car can go on for ever without a blocked action.

    The largest set in which every state has an unblocked action that ends in the set. Without a reverse gear some
    free states lead into dead ends only; an action that ends outside this set must not be taken. Turning on the spot
    for ever counts as going on, so a live state need not lead to the goal: `cost_to_go` says that.

    Args:
        blocked: `(cells, cells, 8, 5)` bool.

    Returns:
        `[iy, ix, heading]` `(cells, cells, 8)` bool.
    """
    cells = len(blocked)
    return _live(blocked.ravel(), predecessors(cells)).reshape(cells, cells, HEADINGS)


@njit(cache=True)
def _search(
    blocked: np.ndarray,
    goals: np.ndarray,
    action_costs: np.ndarray,
    before: np.ndarray,
    until: np.ndarray,
) -> np.ndarray:
    """Label-correcting search over buckets as wide as a quarter of the dearest action.

    A state's bucket is that of its cost and of what is at least `ahead` of it, by cell: nothing (Dijkstra), or the way
    as the crow flies to the nearest state whose cost is wanted (A*). What is in a bucket may still improve within it
    and is then taken up again; once it is empty, the costs of its states are final. Entries that a better one overtook
    are passed over.
    """
    states, actions = before.shape
    per_cost = 4 / action_costs.max()
    cells = int(math.sqrt(states // HEADINGS))
    per_cell = np.inf  # what it costs at least to come a cell's side nearer to anywhere
    for heading in range(HEADINGS):
        for action in range(actions):
            if _ADVANCED[heading, action] > 0:
                per_cell = min(per_cell, action_costs[heading, action] / _ADVANCED[heading, action])
    ahead = per_cell * _to_the_nearest(until, cells)
    cost, expanded = np.full(states, np.inf), np.full(states, np.inf)
    heads = np.full(2 + int(ahead.max() * per_cost), -1, np.int32)  # the first entry of each bucket
    entries, following = np.empty(4 * states, np.int32), np.empty(4 * states, np.int32)
    count = 0
    for cell in np.flatnonzero(goals):
        into = int(ahead[cell] * per_cost)
        for state in range(HEADINGS * cell, HEADINGS * (cell + 1)):
            cost[state] = 0.0
            entries[count], following[count] = state, heads[into]
            heads[into] = count
            count += 1
    bucket, last = 0, len(heads) - 1
    while bucket <= last:
        if bucket + 10 >= len(heads):  # an action leads at most 4 buckets on and, as the crow flies, back by as much
            heads = np.append(heads, np.full(len(heads) + 10, -1, np.int32))
        while heads[bucket] >= 0:
            state = entries[heads[bucket]]
            heads[bucket] = following[heads[bucket]]
            so_far = cost[state]
            if so_far >= expanded[state]:
                continue
            expanded[state] = so_far
            if count + actions > len(entries):
                entries, following = np.append(entries, entries), np.append(following, following)
            for action in range(actions):
                previous = before[state, action]
                if previous < 0:
                    continue
                total = so_far + action_costs[previous & 7, action]
                if total < cost[previous] and not blocked[previous * actions + action]:
                    cost[previous] = total
                    into = max(int((total + ahead[previous >> 3]) * per_cost), bucket)
                    last = max(last, into)
                    entries[count], following[count] = previous, heads[into]
                    heads[into] = count
                    count += 1
        bucket += 1
        wanted = len(until)
        for state in until:
            wanted -= (cost[state] + ahead[state >> 3]) * per_cost < bucket
        if len(until) and not wanted:
            for cell in range(cells * cells):
                for state in range(HEADINGS * cell, HEADINGS * (cell + 1)):
                    cost[state] = cost[state] if (cost[state] + ahead[cell]) * per_cost < bucket else np.inf
            break
    return cost.astype(np.float32)


@njit(cache=True)
def _to_the_nearest(states: np.ndarray, cells: int) -> np.ndarray:
    """How far it is from each cell to the nearest of the cells of `states`, in cells; 0 where there are none."""
    far = np.int32(2 * cells * cells)
    squares = np.full((cells, cells), far if len(states) else np.int32(0))
    for state in states:
        ix, iy = np.int32((state >> 3) % cells), np.int32((state >> 3) // cells)
        for row in range(cells):
            north = np.int32(row) - iy
            for column in range(cells):
                east = np.int32(column) - ix
                squares[row, column] = min(squares[row, column], east * east + north * north)
    return np.sqrt(squares.ravel())


@njit(cache=True)
def _follow(
    cost: np.ndarray, blocked: np.ndarray, action_costs: np.ndarray, after: np.ndarray, start: int
) -> tuple[np.ndarray, np.ndarray, bool]:
    """States and actions from the start down the costs; whether an action was found at each."""
    states, actions = np.empty(len(cost), np.int32), np.empty(len(cost), np.int8)
    count, state = 0, start
    states[0] = start
    while cost[state] > 0:
        best, choice = np.inf, -1
        for action in range(after.shape[1]):
            if not blocked[state * after.shape[1] + action]:
                total = float(cost[after[state, action]]) + action_costs[state & 7, action]
                if total < best:
                    best, choice = total, action
        if choice < 0 or count + 1 == len(cost):
            return states[: count + 1], actions[:count], False
        state = after[state, choice]
        actions[count] = choice
        count += 1
        states[count] = state
    return states[: count + 1], actions[:count], True


@njit(cache=True)
def _live(blocked: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Takes away states without an action left, then what led only to them, until nothing changes."""
    count, actions = before.shape
    left = np.zeros(count, dtype=np.int8)  # actions that end in a state not taken away
    dead, found = np.empty(count, dtype=np.int32), 0
    for state in range(count):
        for action in range(actions):
            left[state] += not blocked[state * actions + action]
        if left[state] == 0:
            dead[found] = state
            found += 1
    looked = 0
    while looked < found:
        state = dead[looked]
        looked += 1
        for action in range(actions):
            previous = before[state, action]
            if previous < 0 or blocked[previous * actions + action]:
                continue
            left[previous] -= 1
            if left[previous] == 0:
                dead[found] = previous
                found += 1
    return left > 0
