"""The planning lattice as a graph of flat states, for compiled searches: tables of successors and predecessors.

The flat state of `(ix, iy, heading)` is `(iy * cells + ix) * 8 + heading`, the order of arrays `(cells, cells, 8)`.
"""

from functools import cache

import numpy as np

from zsdist.planning.footprint import ACTIONS, ADVANCES, TURNS
from zsdist.planning.grid import HEADINGS, STEPS
from zsdist.types import LatticeState

NOWHERE = -1  # entry of `successors` and `predecessors` for a state off the grid


@cache
def successors(cells: int) -> np.ndarray:
    """Return the state in which each action ends, `(cells * cells * 8, 5)` int32, read-only; `NOWHERE` off the grid."""
    iy, ix, heading = np.indices((cells, cells, HEADINGS)).reshape(3, -1, 1)
    ends = (heading + np.array(TURNS)) % HEADINGS
    advances = np.array(ADVANCES)
    return _flat(cells, ix + STEPS[ends, 0] * advances, iy + STEPS[ends, 1] * advances, ends)


@cache
def predecessors(cells: int) -> np.ndarray:
    """Return the state from which each action leads to a state, `(cells * cells * 8, 5)` int32, read-only."""
    iy, ix, heading = np.indices((cells, cells, HEADINGS)).reshape(3, -1, 1)
    advances = np.array(ADVANCES)
    before = (heading - np.array(TURNS)) % HEADINGS
    return _flat(cells, ix - STEPS[heading, 0] * advances, iy - STEPS[heading, 1] * advances, before)


@cache
def successors_or_self(cells: int) -> np.ndarray:
    """Return `successors` as uint32, with the state itself for an action that leads off the grid.

    Loops that read a successor before they know whether the action is blocked need indices that are never negative.
    """
    return _with_self(successors(cells))


@cache
def predecessors_or_self(cells: int) -> np.ndarray:
    """Return `predecessors` as uint32, with the state itself for an action that would start off the grid."""
    return _with_self(predecessors(cells))


def flat_state(state: LatticeState, cells: int) -> int:
    """Return the flat state of a lattice state."""
    return (state.iy * cells + state.ix) * HEADINGS + state.heading


def lattice_state(flat: int, cells: int) -> LatticeState:
    """Return the lattice state of a flat state."""
    return LatticeState(flat // HEADINGS % cells, flat // (HEADINGS * cells), flat % HEADINGS)


def _with_self(table: np.ndarray) -> np.ndarray:
    filled = np.where(table == NOWHERE, np.arange(len(table))[:, None], table).astype(np.uint32)
    filled.flags.writeable = False
    return filled


def _flat(cells: int, ix: np.ndarray, iy: np.ndarray, heading: np.ndarray) -> np.ndarray:
    inside = (ix >= 0) & (ix < cells) & (iy >= 0) & (iy < cells)
    table = np.where(inside, (iy * cells + ix) * HEADINGS + heading, NOWHERE).astype(np.int32)
    assert table.shape[1] == ACTIONS
    table.flags.writeable = False
    return table
