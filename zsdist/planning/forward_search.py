"""Forward search from one state over free moves."""

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.planning.footprint import ACTIONS
from zsdist.planning.grid import HEADINGS
from zsdist.planning.lattice import flat_state, successors_or_self
from zsdist.types import LatticeState


def path_lengths_from(blocked: np.ndarray, state: LatticeState, action_costs: np.ndarray) -> np.ndarray:
    """Return the length of the shortest free path from a state into each cell.

    Args:
        blocked: `(cells, cells, 8, 5)` bool, blocked moves.
        state: start of the paths.
        action_costs: `(8, 5)`, by heading before the action, metres.

    Returns:
        `[iy, ix]` `(cells, cells)` float64, metres; infinite where no free path leads.
    """
    cells, start = len(blocked), flat_state(state, len(blocked))
    return _least_cost_of_cells(blocked.ravel(), successors_or_self(cells), action_costs, start).reshape(cells, cells)


@compiled()
def spread_costs(
    blocked: np.ndarray, after: np.ndarray, action_costs: np.ndarray, start: int, limit: float, cost: np.ndarray
) -> None:
    """Write to `cost` the least cost from a state to every state that costs no more than `limit`.

    Args:
        blocked: `(states * 5,)` bool, blocked moves, by flat state and action.
        after: table `lattice.successors_or_self`.
        action_costs: `(8, 5)`, by heading before the action.
        start: flat state in which all paths begin.
        limit: greatest cost of a path.
        cost: `(states,)`, infinite before the call; written in place.
    """
    width = action_costs.min()  # no action leads from a state of a band of costs to another state of the same band
    front = np.empty(len(after) + 1, np.uint32)  # states that are still to be expanded
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
            for action in range(np.uint64(ACTIONS)):  # without branches, which the processor could not predict
                end, total = np.uint64(after[state, action]), so_far + action_costs[state & np.uint64(7), action]
                before = cost[end]
                better = (not blocked[state * np.uint64(ACTIONS) + action]) & (total < before) & (total <= limit)
                cost[end] = total if better else before
                front[count] = end
                count += np.uint64(better & (before == np.inf))
        count = kept


@compiled()
def _least_cost_of_cells(blocked: np.ndarray, after: np.ndarray, action_costs: np.ndarray, start: int) -> np.ndarray:
    """Return the least cost from a state to any state of each cell, `(cells * cells,)`."""
    cost = np.full(len(after), np.inf)
    spread_costs(blocked, after, action_costs, start, np.inf, cost)
    least = np.full(len(cost) // HEADINGS, np.inf)
    for cell in range(len(least)):
        for state in range(HEADINGS * cell, HEADINGS * (cell + 1)):
            least[cell] = min(least[cell], cost[state])
    return least
