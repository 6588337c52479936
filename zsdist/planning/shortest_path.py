"""Shortest paths over (cell, heading), and the viable states, from which the car can keep driving.

Both use `blocked`, `[iy, ix, heading, action]` `(cells, cells, 8, 5)` bool, from `FootprintTable.blocked`. The car has
no reverse gear, so the graph is directed: costs to go are found from the goal against the direction of travel.
"""

import math
from typing import NamedTuple

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.planning.cost_field import CostField
from zsdist.planning.footprint import ACTIONS, ADVANCES, TURNS
from zsdist.planning.grid import HEADINGS, STEPS, Grid
from zsdist.planning.lattice import flat_state, lattice_state, predecessors, successors
from zsdist.types import Action, LatticeState

STEPS_COST = np.ones((HEADINGS, ACTIONS))  # cost of each action from each heading, counted in actions
_ACTION_TIE_M = 1e-3  # cost of an action on top of its metres: the fewest actions win among equally long paths
_TURN_TIE_M = 2e-4  # cost of an eighth of a turn: the fewest turns win among paths equal in length and actions

_ENDS = (np.arange(HEADINGS)[:, None] + np.array(TURNS)) % HEADINGS
_ADVANCED = np.hypot(STEPS[_ENDS, 0], STEPS[_ENDS, 1]) * ADVANCES  # by heading before the action, in sides of a cell


class LatticePath(NamedTuple):
    """A path: `states` from the start to the goal, and the `actions` between them, one fewer."""

    states: list[LatticeState]
    actions: list[Action]


def metres_cost(grid: Grid) -> np.ndarray:
    """Return the cost of each action from each heading, `(8, 5)` float64: metres driven plus about a millimetre.

    The millimetre prefers fewer actions and fewer turns among paths of equal length, and keeps turns in place from
    being free; `length_m` gives the length of a path without it.
    """
    costs: np.ndarray = _ADVANCED * grid.cell_size_m + _ACTION_TIE_M + _TURN_TIE_M * np.abs(TURNS)
    return costs


METRES = metres_cost(Grid())  # cost of each action on the default grid


def goal_mask(grid: Grid, goal_xy: tuple[float, float], radius_m: float) -> np.ndarray:
    """Return the cells whose centre is within `radius_m` of the goal, `[iy, ix]` `(cells, cells)` bool."""
    xs, ys = grid.cell_centres()
    return np.hypot(xs[None, :] - goal_xy[0], ys[:, None] - goal_xy[1]) <= radius_m


def cost_to_go(blocked: np.ndarray, goals: np.ndarray, action_costs: np.ndarray) -> np.ndarray:
    """Return the least cost from every state to a goal cell, with any heading there.

    Args:
        blocked: `(cells, cells, 8, 5)` bool, blocked moves.
        goals: `[iy, ix]` `(cells, cells)` bool, goal cells.
        action_costs: `(8, 5)`, by heading before the action, above 0; `METRES` or `STEPS_COST`.

    Returns:
        `[iy, ix, heading]` `(cells, cells, 8)` float32; infinite where no goal cell can be reached.

    Raises:
        ValueError: an action costs nothing or less.
    """
    if not np.min(action_costs) > 0:
        raise ValueError(f"the least action cost is {np.min(action_costs)}; allowed is above 0")
    return CostField(goals, action_costs).costs_on(blocked)


def path(cost: np.ndarray, blocked: np.ndarray, start: LatticeState, action_costs: np.ndarray) -> LatticePath:
    """Return the shortest path from `start`, found by descending the costs of `cost_to_go`.

    Args:
        cost: `(cells, cells, 8)` float32, from `cost_to_go` with the same `blocked` and `action_costs`.
        blocked: `(cells, cells, 8, 5)` bool, blocked moves.
        start: start of the path.
        action_costs: `(8, 5)`, by heading before the action.

    Raises:
        ValueError: no goal cell can be reached from `start`, or the costs belong to another `blocked`.
    """
    flat, actions = flat_path(cost, blocked, start, action_costs)
    states = [lattice_state(state, len(blocked)) for state in flat.tolist()]
    return LatticePath(states, [Action(action) for action in actions.tolist()])


def flat_path(
    cost: np.ndarray, blocked: np.ndarray, start: LatticeState, action_costs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the path of `path` as flat states `(n,)` int32 and actions `(n - 1,)` int8."""
    if not math.isfinite(cost[start.iy, start.ix, start.heading]):
        raise ValueError(f"no path leads from {start} to the goal")
    cells = len(blocked)
    flat, actions, arrived = _follow(
        cost.ravel(), blocked.ravel(), action_costs, successors(cells), flat_state(start, cells)
    )
    if not arrived:
        last = lattice_state(int(flat[-1]), cells)
        raise ValueError(f"every action from {last} is blocked; the costs belong to another map")
    return flat, actions


def length_m(states: list[LatticeState], cell_size_m: float) -> float:
    """Return the metres driven along a path; turns in place add nothing."""
    cells = np.array([(state.ix, state.iy) for state in states]).reshape(-1, 2)
    return float(np.hypot(*np.diff(cells, axis=0).T).sum() * cell_size_m)


def viable_states(blocked: np.ndarray) -> np.ndarray:
    """Return the states from which the car can keep driving forever without a blocked action (the viability kernel).

    This is the largest set in which every state has an unblocked action that ends in the set. Without a reverse gear
    some free states lead into dead ends only, so an action that ends outside this set must not be taken. Turning in
    place forever counts as driving, so the goal need not be reachable from a viable state; for that see `cost_to_go`.

    Args:
        blocked: `(cells, cells, 8, 5)` bool, blocked moves.

    Returns:
        `[iy, ix, heading]` `(cells, cells, 8)` bool.
    """
    cells = len(blocked)
    return _viable(blocked.ravel(), predecessors(cells)).reshape(cells, cells, HEADINGS)


@compiled()
def _follow(
    cost: np.ndarray, blocked: np.ndarray, action_costs: np.ndarray, after: np.ndarray, start: int
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return the states and actions that descend the costs from the start, and whether a goal cell was reached."""
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


@compiled()
def _viable(blocked: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the states left after repeated removal of states without an unblocked action into a remaining state."""
    count, actions = before.shape
    left = np.zeros(count, dtype=np.int8)  # unblocked actions that end in a state not removed
    dead, found = np.empty(count, dtype=np.int32), 0  # removed states
    for state in range(count):
        for action in range(actions):
            left[state] += not blocked[state * actions + action]
        if left[state] == 0:
            dead[found] = state
            found += 1
    handled = 0
    while handled < found:
        state = dead[handled]
        handled += 1
        for action in range(actions):
            previous = before[state, action]
            if previous < 0 or blocked[previous * actions + action]:
                continue
            left[previous] -= 1
            if left[previous] == 0:
                dead[found] = previous
                found += 1
    return left > 0
