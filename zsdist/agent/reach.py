"""Where free ways lead, forwards from a state and backwards from a place; no lengths, only whether."""

import numba
import numpy as np

from zsdist.planning.footprint import ADVANCES, TURNS
from zsdist.planning.grid import STEPS
from zsdist.types import LatticeState

_TURNS = np.array(TURNS)
_ADVANCES = np.array(ADVANCES)
_STEPS = np.asarray(STEPS)


def cells_from(blocked: np.ndarray, state: LatticeState) -> np.ndarray:
    """Cells `(cells, cells)` bool to which a free way leads from a state, its own included."""
    return _forwards(blocked, state.ix, state.iy, state.heading)


def states_to(blocked: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """States `(cells, cells, 8)` bool from which a free way leads to one of the cells `goals` `(cells, cells)` bool."""
    return _backwards(blocked, goals)


@numba.njit(cache=True)
def _forwards(blocked, ix, iy, heading):  # noqa: ANN001, ANN202
    cells = blocked.shape[0]
    found = np.zeros((cells, cells, 8), np.bool_)
    queue = np.empty((cells * cells * 8, 3), np.int16)
    queue[0, 0], queue[0, 1], queue[0, 2] = ix, iy, heading
    found[iy, ix, heading] = True
    reached = np.zeros((cells, cells), np.bool_)
    read, written = 0, 1
    while read < written:
        x, y, h = queue[read]
        read += 1
        reached[y, x] = True
        for action in range(5):
            if blocked[y, x, h, action]:
                continue
            k = (h + _TURNS[action]) % 8
            nx, ny = x + _STEPS[k, 0] * _ADVANCES[action], y + _STEPS[k, 1] * _ADVANCES[action]
            if not found[ny, nx, k]:
                found[ny, nx, k] = True
                queue[written, 0], queue[written, 1], queue[written, 2] = nx, ny, k
                written += 1
    return reached


@numba.njit(cache=True)
def _backwards(blocked, goals):  # noqa: ANN001, ANN202
    cells = blocked.shape[0]
    found = np.zeros((cells, cells, 8), np.bool_)
    queue = np.empty((cells * cells * 8, 3), np.int16)
    read, written = 0, 0
    for y in range(cells):
        for x in range(cells):
            if goals[y, x]:
                for h in range(8):
                    found[y, x, h] = True
                    queue[written, 0], queue[written, 1], queue[written, 2] = x, y, h
                    written += 1
    while read < written:
        x, y, h = queue[read]
        read += 1
        for action in range(5):
            k = (h - _TURNS[action]) % 8
            px, py = x - _STEPS[h, 0] * _ADVANCES[action], y - _STEPS[h, 1] * _ADVANCES[action]
            if px < 0 or py < 0 or px >= cells or py >= cells or found[py, px, k] or blocked[py, px, k, action]:
                continue
            found[py, px, k] = True
            queue[written, 0], queue[written, 1], queue[written, 2] = px, py, k
            written += 1
    return found
