"""How far free ways lead from a state."""

import numba
import numpy as np

from zsdist.planning.grid import HEADINGS
from zsdist.planning.lattice import flat_state, successors
from zsdist.types import LatticeState


def metres_from(blocked: np.ndarray, state: LatticeState, action_costs: np.ndarray) -> np.ndarray:
    """Length of the shortest free way from a state into each cell, `(cells, cells)`; infinite where none leads there.

    Args:
        blocked: `(cells, cells, 8, 5)` bool.
        state: where it begins.
        action_costs: `(8, 5)`, by heading before the action, metres.
    """
    cells = len(blocked)
    cost = forwards(blocked.ravel(), successors(cells), action_costs, flat_state(state, cells), np.inf)
    return _least(cost).reshape(cells, cells)


@numba.njit(cache=True)
def forwards(blocked, after, action_costs, start, limit):  # noqa: ANN001, ANN201
    """Least cost from a state to every state that costs no more than `limit`; infinite elsewhere.

    Args:
        blocked: `(states * actions,)` bool, of flat states.
        after: of `lattice.successors`.
        action_costs: `(8, 5)`, by heading before the action.
        start: flat state.
        limit: the most a way may cost.

    Returns:
        `(states,)`.
    """
    states, actions = after.shape
    width = action_costs.min()  # no action leads from a state of one band of costs to another of the same
    cost, known = np.full(states, np.inf), np.zeros(states, np.bool_)
    front = np.empty(states + 1, np.int32)  # states whose actions are still to be followed
    front[0], cost[start], known[start] = start, 0.0, True
    count, band = 1, 0.0
    while count:
        band += width
        read, kept = 0, 0
        while read < count:
            state = front[read]
            read += 1
            if cost[state] > band:
                front[kept] = state
                kept += 1
                continue
            so_far = cost[state]
            for action in range(actions):  # without branches, which nobody could foretell
                end, total = after[state, action], so_far + action_costs[state & 7, action]
                better = (not blocked[state * actions + action]) & (total < cost[end]) & (total <= limit)
                cost[end] = total if better else cost[end]
                front[count] = end
                count += better & (not known[end])
                known[end] |= better
        count = kept
    return cost


@numba.njit(cache=True)
def _least(cost):  # noqa: ANN001, ANN202
    """The least of each cell's states."""
    least = np.full(len(cost) // HEADINGS, np.inf)
    for cell in range(len(least)):
        for state in range(HEADINGS * cell, HEADINGS * (cell + 1)):
            least[cell] = min(least[cell], cost[state])
    return least
