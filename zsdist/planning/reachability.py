"""Reachability on the planning lattice with one bit per state, computed for whole rows of cells at once.

A word holds 64 cells of a row, one a bit. A set of cells is `(words, cells)` uint64, indexed by word of a row and by
row. A set of states is `(8, words, cells)`, one set of cells for each heading. Bits beyond the last cell of a row are
blocked and belong to no set.
"""

from functools import cached_property

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.planning import bitmaps
from zsdist.planning.footprint import ACTIONS, ADVANCES, CELLS_PER_WORD, TURNS, FootprintTable, unpack_states
from zsdist.planning.grid import HEADINGS, STEPS
from zsdist.types import LatticeState

_STEPS = np.asarray(STEPS)
_TURNS = np.array(TURNS)
_MOVING = sum(ADVANCES)  # number of actions that end in another cell; these are the first ones
assert ADVANCES == (1,) * _MOVING + (0,) * (ACTIONS - _MOVING)


class BlockedMoves:
    """Set of the moves, as pairs of state and action, that are blocked on one map.

    Args:
        words: `(8, 5, words, cells)` uint64, by heading, action, word of a row, row.
    """

    def __init__(self, words: np.ndarray) -> None:
        self.words = words

    @classmethod
    def from_array(cls, blocked: np.ndarray) -> "BlockedMoves":
        """Return the set that an array `(cells, cells, 8, 5)` bool describes; the inverse of the property `blocked`."""
        cells = len(blocked)
        words = ~pack_states(~blocked.reshape(cells, cells, -1))
        return cls(words.reshape(HEADINGS, ACTIONS, -1, cells))

    @classmethod
    def from_occupancy(cls, occupancy: np.ndarray, table: FootprintTable) -> "BlockedMoves":
        """Return the moves whose footprint meets an occupied fine cell of a bitmap, or that end off the grid."""
        return cls(table.words(occupancy).reshape(HEADINGS, ACTIONS, -1, table.grid.cells))

    @cached_property
    def blocked(self) -> np.ndarray:
        """The set as an array `[iy, ix, heading, action]` `(cells, cells, 8, 5)` bool."""
        cells = self.words.shape[-1]
        flags = unpack_states(self.words.reshape(HEADINGS * ACTIONS, -1, cells))
        return flags.reshape(cells, cells, HEADINGS, ACTIONS)

    def at_state(self, state: LatticeState) -> np.ndarray:
        """Return whether each action is blocked in one state, `(5,)` bool."""
        words = self.words[state.heading, :, state.ix // CELLS_PER_WORD, state.iy].tolist()
        return np.array([word >> state.ix % CELLS_PER_WORD & 1 for word in words], np.bool_)

    def where(self, states: np.ndarray, otherwise: "BlockedMoves") -> "BlockedMoves":
        """Return the set with these moves in a set of states, and with those of `otherwise` in all other states."""
        differ = (self.words ^ otherwise.words) & states[:, None]
        return BlockedMoves(otherwise.words ^ differ)

    def states_reaching(self, cells: np.ndarray) -> np.ndarray:
        """Return the states from which a free path leads to a set of cells; the states in these cells are included."""
        return _states_reaching(self.words, cells)

    def blocking_exits_from(self, states: np.ndarray) -> "BlockedMoves":
        """Return this set with the moves added that end outside a set of states."""
        return BlockedMoves(_blocking_exits(self.words, states))


@compiled()
def pack_states(flags: np.ndarray) -> np.ndarray:
    """Return flags `(cells, cells, planes)` as bits `(planes, words, cells)`; bits beyond a row's last cell are 0.

    A plane is a heading, or a pair of heading and action.
    """
    rows, columns, planes = flags.shape
    words = np.zeros((planes, (columns - 1) // CELLS_PER_WORD + 1, rows), np.uint64)
    for iy in range(rows):
        for ix in range(columns):
            bit = np.uint64(ix % CELLS_PER_WORD)
            for plane in range(planes):
                words[plane, ix // CELLS_PER_WORD, iy] |= np.uint64(flags[iy, ix, plane]) << bit
    return words


def pack_cells(mask: np.ndarray) -> np.ndarray:
    """Return the set of cells `(words, cells)` of a mask `[iy, ix]` `(cells, cells)` bool."""
    return np.ascontiguousarray(bitmaps.pack_rows(mask).T)


def contains_state(states: np.ndarray, state: LatticeState) -> bool:
    """Return whether a state is in a set of states."""
    word = int(states[state.heading, state.ix // CELLS_PER_WORD, state.iy])
    return bool(word >> state.ix % CELLS_PER_WORD & 1)


@compiled()
def _cells_before_advance(states: np.ndarray, heading: int, out: np.ndarray) -> None:
    """Write to `out` the cells from which an advance along a heading ends in a set of states of that heading.

    Both arrays have a border of zeros.
    """
    dx, dy = _STEPS[heading]
    one, rest = np.uint64(1), np.uint64(CELLS_PER_WORD - 1)
    for word in range(1, states.shape[0] - 1):
        for row in range(1, states.shape[1] - 1):
            here = states[word, row + dy]
            if dx > 0:
                here = here >> one | states[word + 1, row + dy] << rest
            elif dx < 0:
                here = here << one | states[word - 1, row + dy] >> rest
            out[word, row] = here


@compiled()
def _add_unblocked(states: np.ndarray, candidates: np.ndarray, blocked: np.ndarray) -> bool:
    """Add to the states of one heading the candidates in which an action is not blocked; return whether any was new."""
    added = np.uint64(0)
    for word in range(1, states.shape[0] - 1):
        for row in range(1, states.shape[1] - 1):
            new = candidates[word, row] & ~blocked[word - 1, row - 1] & ~states[word, row]
            states[word, row] |= new
            added |= new
    return bool(added)


@compiled()
def _states_reaching(blocked: np.ndarray, cells: np.ndarray) -> np.ndarray:
    words, rows = cells.shape
    found = np.zeros((HEADINGS, words + 2, rows + 2), np.uint64)
    for heading in range(HEADINGS):
        found[heading, 1:-1, 1:-1] = cells
    before_advance, waiting = np.zeros((words + 2, rows + 2), np.uint64), np.ones(HEADINGS, np.bool_)
    while waiting.any():
        for end in range(HEADINGS):  # heading after the action
            if not waiting[end]:
                continue
            waiting[end] = False
            _cells_before_advance(found[end], end, before_advance)
            while _add_unblocked(found[end], before_advance, blocked[end, 0]):  # straight on as far as it goes
                _cells_before_advance(found[end], end, before_advance)
            for action in range(1, ACTIONS):
                heading = (end - _TURNS[action]) % HEADINGS
                before = before_advance if action < _MOVING else found[end]
                waiting[heading] |= _add_unblocked(found[heading], before, blocked[heading, action])
    return found[:, 1:-1, 1:-1].copy()


@compiled()
def _blocking_exits(blocked: np.ndarray, states: np.ndarray) -> np.ndarray:
    _, words, rows = states.shape
    inside, before_advance = np.zeros((words + 2, rows + 2), np.uint64), np.zeros((words + 2, rows + 2), np.uint64)
    out = blocked.copy()
    for end in range(HEADINGS):  # heading after the action
        inside[1:-1, 1:-1] = states[end]
        _cells_before_advance(inside, end, before_advance)
        for action in range(ACTIONS):
            before = before_advance if action < _MOVING else inside
            heading = (end - _TURNS[action]) % HEADINGS
            out[heading, action] |= ~before[1:-1, 1:-1]
    return out
