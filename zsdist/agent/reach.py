"""Where free ways lead, forwards from a state and backwards from a place; no lengths, only whether."""

import numba
import numpy as np

from zsdist.planning.grid import HEADINGS
from zsdist.planning.lattice import flat_state, predecessors, successors
from zsdist.types import LatticeState


def cells_from(blocked: np.ndarray, state: LatticeState) -> np.ndarray:
    """Cells `(cells, cells)` bool to which a free way leads from a state, its own included."""
    cells = len(blocked)
    return _forwards(blocked.ravel(), successors(cells), flat_state(state, cells)).reshape(cells, cells)


def states_to(blocked: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """States `(cells, cells, 8)` bool from which a free way leads to one of the cells `goals` `(cells, cells)` bool."""
    cells = len(blocked)
    return _backwards(blocked.ravel(), goals.ravel(), predecessors(cells)).reshape(cells, cells, HEADINGS)


@numba.njit(cache=True)
def _forwards(blocked, after, start):  # noqa: ANN001, ANN202
    states, actions = after.shape
    found, reached = np.zeros(states, np.bool_), np.zeros(states >> 3, np.bool_)
    queue = np.empty(states, np.int32)
    queue[0] = start
    found[start] = True
    read, written = 0, 1
    while read < written:
        state = queue[read]
        read += 1
        reached[state >> 3] = True
        for action in range(actions):
            if not blocked[state * actions + action]:
                end = after[state, action]
                if not found[end]:
                    found[end] = True
                    queue[written] = end
                    written += 1
    return reached


@numba.njit(cache=True)
def _backwards(blocked, goals, before):  # noqa: ANN001, ANN202
    states, actions = before.shape
    found = np.zeros(states, np.bool_)
    queue = np.empty(states, np.int32)
    read, written = 0, 0
    for state in range(states):
        if goals[state >> 3]:
            found[state] = True
            queue[written] = state
            written += 1
    while read < written:
        state = queue[read]
        read += 1
        for action in range(actions):
            previous = before[state, action]
            if previous >= 0 and not found[previous] and not blocked[previous * actions + action]:
                found[previous] = True
                queue[written] = previous
                written += 1
    return found
