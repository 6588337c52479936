"""How far free ways lead from a state."""

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.planning.footprint import ACTIONS
from zsdist.planning.grid import HEADINGS
from zsdist.planning.lattice import ends, flat_state
from zsdist.types import LatticeState


def metres_from(blocked: np.ndarray, state: LatticeState, action_costs: np.ndarray) -> np.ndarray:
    """Length of the shortest free way from a state into each cell, `(cells, cells)`; infinite where none leads there.

    Args:
        blocked: `(cells, cells, 8, 5)` bool.
        state: where it begins.
        action_costs: `(8, 5)`, by heading before the action, metres.
    """
    cells = len(blocked)
    return _metres(blocked.ravel(), ends(cells), action_costs, flat_state(state, cells)).reshape(cells, cells)


@compiled()
def forwards(blocked, after, action_costs, start, limit, cost):  # noqa: ANN001, ANN201
    """Puts the least cost from a state into `cost`, of every state that costs no more than `limit`.

    Args:
        blocked: `(states * 5,)` bool, of flat states.
        after: of `lattice.ends`.
        action_costs: `(8, 5)`, by heading before the action.
        start: flat state.
        limit: the most a way may cost.
        cost: `(states,)`, infinite before.
    """
    width = action_costs.min()  # no action leads from a state of one band of costs to another of the same
    front = np.empty(len(after) + 1, np.uint32)  # states whose actions are still to be followed
    front[0], cost[start] = start, 0.0
    count, band = np.uint64(1), 0.0
    while count:
        band += width
        read, kept = np.uint64(0), np.uint64(0)
        while read < count:
            state = np.uint64(front[read])
            read += np.uint64(1)
            so_far = cost[state]
            if so_far > band:
                front[kept] = state
                kept += np.uint64(1)
                continue
            for action in range(np.uint64(ACTIONS)):  # without branches, which nobody could foretell
                end, total = np.uint64(after[state, action]), so_far + action_costs[state & np.uint64(7), action]
                before = cost[end]
                better = (not blocked[state * np.uint64(ACTIONS) + action]) & (total < before) & (total <= limit)
                cost[end] = total if better else before
                front[count] = end
                count += np.uint64(better & (before == np.inf))
        count = kept


@compiled()
def _metres(blocked, after, action_costs, start):  # noqa: ANN001, ANN202
    """The least cost from a state to any state of each cell."""
    cost = np.full(len(after), np.inf)
    forwards(blocked, after, action_costs, start, np.inf, cost)
    least = np.full(len(cost) // HEADINGS, np.inf)
    for cell in range(len(least)):
        for state in range(HEADINGS * cell, HEADINGS * (cell + 1)):
            least[cell] = min(least[cell], cost[state])
    return least
