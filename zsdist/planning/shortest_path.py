"""Shortest ways over (cell, heading), and the states from which the car can keep going.

Both start from `blocked`, `[iy, ix, heading, action]` `(cells, cells, 8, 5)` bool, of `FootprintTable.blocked`. The
car has no reverse gear, so the graph is directed: costs to go are found from the goal against the direction of travel.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from zsdist.planning.footprint import ACTIONS, ADVANCES, TURNS, successor
from zsdist.planning.grid import HEADINGS, STEPS, Grid
from zsdist.types import Action, LatticeState

STEPS_COST = np.ones((HEADINGS, ACTIONS))  # cost of each action from each heading, counted in actions
_ACTION_TIE_M = 1e-3  # an action's cost on top of its metres: of equally long ways the one of fewer actions wins,
_TURN_TIE_M = 2e-4  # and of those the one that turns through fewer eighths

_TURNS = np.array(TURNS)
_ADVANCES = np.array(ADVANCES)


class Path(NamedTuple):
    """A way: `states` from the start to the goal, and the `actions` between them, one fewer."""

    states: list[LatticeState]
    actions: list[Action]


def metres_cost(grid: Grid) -> np.ndarray:
    """Cost of each action from each heading, `(8, 5)` float64: metres driven, and about a millimetre for the action.

    The millimetre prefers fewer actions and fewer turns among ways of equal length and keeps turns in place from being
    free; `length_m` gives a way's length without it.
    """
    ends = (np.arange(HEADINGS)[:, None] + _TURNS) % HEADINGS
    tie_m = _ACTION_TIE_M + _TURN_TIE_M * np.abs(_TURNS)
    return np.hypot(STEPS[ends, 0], STEPS[ends, 1]) * _ADVANCES * grid.cell_size_m + tie_m


METRES = metres_cost(Grid())  # of the default grid


def goal_mask(grid: Grid, goal_xy: tuple[float, float], radius_m: float) -> np.ndarray:
    """Cells whose centre is within `radius_m` of the goal, `[iy, ix]` `(cells, cells)` bool."""
    xs, ys = grid.cell_centres()
    return np.hypot(xs[None, :] - goal_xy[0], ys[:, None] - goal_xy[1]) <= radius_m


def cost_to_go(blocked: np.ndarray, goals: np.ndarray, action_costs: np.ndarray) -> np.ndarray:
    """Least cost from every state to a goal cell, whatever the heading there (Dijkstra).

    Args:
        blocked: `(cells, cells, 8, 5)` bool.
        goals: `[iy, ix]` `(cells, cells)` bool.
        action_costs: `(8, 5)`, by heading before the action, above 0; `METRES` or `STEPS_COST`.

    Returns:
        `[iy, ix, heading]` `(cells, cells, 8)` float32; infinite where no goal cell can be reached.

    Raises:
        ValueError: an action costs nothing or less.
    """
    if not np.min(action_costs) > 0:
        raise ValueError(f"the least action cost is {np.min(action_costs)}; allowed is above 0")
    return _dijkstra(blocked, goals, np.asarray(action_costs, dtype=np.float64), _TURNS, _ADVANCES, STEPS)


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
    if not math.isfinite(cost[start.iy, start.ix, start.heading]):
        raise ValueError(f"no way leads from {start} to the goal")
    states, actions = [start], []
    state = start
    while cost[state.iy, state.ix, state.heading] > 0:
        best, choice, following = math.inf, Action.FORWARD, state
        for action in Action:
            if blocked[state.iy, state.ix, state.heading, action]:
                continue
            end = successor(state, action)
            total = float(cost[end.iy, end.ix, end.heading]) + float(action_costs[state.heading, action])
            if total < best:
                best, choice, following = total, action, end
        if math.isinf(best):
            raise ValueError(f"every action from {state} is blocked; the costs belong to another map")
        state = following
        states.append(state)
        actions.append(choice)
    return Path(states, actions)


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
    return _live(blocked, _TURNS, _ADVANCES, STEPS)


@njit(cache=True)
def _dijkstra(
    blocked: np.ndarray,
    goals: np.ndarray,
    action_costs: np.ndarray,
    turns: np.ndarray,
    advances: np.ndarray,
    steps: np.ndarray,
) -> np.ndarray:
    """Dijkstra with a binary heap in which a state has one place, moved up when its cost falls."""
    cells, headings, actions = blocked.shape[0], blocked.shape[2], blocked.shape[3]
    count = cells * cells * headings
    cost = np.full(count, np.inf)
    heap, place, held = np.empty(count, dtype=np.int64), np.full(count, -1), 0
    for iy in range(cells):
        for ix in range(cells):
            if goals[iy, ix]:
                for heading in range(headings):
                    state = (iy * cells + ix) * headings + heading
                    cost[state], heap[held], place[state] = 0.0, state, held
                    held += 1
    while held:
        state = heap[0]
        held -= 1
        if held:
            _sink(heap, place, cost, heap[held], held)
        heading, ix, iy = state % headings, state // headings % cells, state // (headings * cells)
        for action in range(actions):
            before = (heading - turns[action]) % headings
            px, py = ix - steps[heading, 0] * advances[action], iy - steps[heading, 1] * advances[action]
            if not (0 <= px < cells and 0 <= py < cells) or blocked[py, px, before, action]:
                continue
            previous = (py * cells + px) * headings + before
            total = cost[state] + action_costs[before, action]
            if total < cost[previous]:
                cost[previous] = total
                if place[previous] < 0:
                    place[previous] = held
                    held += 1
                _rise(heap, place, cost, previous)
    return cost.astype(np.float32).reshape(cells, cells, headings)


@njit(cache=True)
def _rise(heap: np.ndarray, place: np.ndarray, cost: np.ndarray, state: int) -> None:
    """Moves a state from its place towards the root."""
    at = place[state]
    while at:
        parent = (at - 1) // 2
        if cost[heap[parent]] <= cost[state]:
            break
        heap[at] = heap[parent]
        place[heap[at]] = at
        at = parent
    heap[at] = state
    place[state] = at


@njit(cache=True)
def _sink(heap: np.ndarray, place: np.ndarray, cost: np.ndarray, state: int, held: int) -> None:
    """Puts a state at the root and moves it away from there."""
    at = 0
    while True:
        child = 2 * at + 1
        if child >= held:
            break
        if child + 1 < held and cost[heap[child + 1]] < cost[heap[child]]:
            child += 1
        if cost[state] <= cost[heap[child]]:
            break
        heap[at] = heap[child]
        place[heap[at]] = at
        at = child
    heap[at] = state
    place[state] = at


@njit(cache=True)
def _live(blocked: np.ndarray, turns: np.ndarray, advances: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Takes away states without an action left, then what led only to them, until nothing changes."""
    cells, headings, actions = blocked.shape[0], blocked.shape[2], blocked.shape[3]
    count = cells * cells * headings
    left = np.zeros(count, dtype=np.int64)  # actions that end in a state not taken away
    dead, found = np.empty(count, dtype=np.int64), 0
    for iy in range(cells):
        for ix in range(cells):
            for heading in range(headings):
                state = (iy * cells + ix) * headings + heading
                for action in range(actions):
                    if not blocked[iy, ix, heading, action]:
                        left[state] += 1
                if left[state] == 0:
                    dead[found] = state
                    found += 1
    looked = 0
    while looked < found:
        state = dead[looked]
        looked += 1
        heading, ix, iy = state % headings, state // headings % cells, state // (headings * cells)
        for action in range(actions):
            before = (heading - turns[action]) % headings
            px, py = ix - steps[heading, 0] * advances[action], iy - steps[heading, 1] * advances[action]
            if not (0 <= px < cells and 0 <= py < cells) or blocked[py, px, before, action]:
                continue
            previous = (py * cells + px) * headings + before
            left[previous] -= 1
            if left[previous] == 0:
                dead[found] = previous
                found += 1
    return (left > 0).reshape(cells, cells, headings)
