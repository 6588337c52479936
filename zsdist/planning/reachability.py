"""Which actions are blocked, a bit each: what can be reached at all is found for whole rows of cells at once.

A word holds 64 cells of a row, bit j its j-th. Places are `(words, cells)` uint64, by word of a row and row; states
`(8, words, cells)`, one such table a heading. Bits beyond the last cell of a row are blocked, and in no set.
"""

from functools import cached_property

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.planning import bitmaps
from zsdist.planning.footprint import ACTIONS, ADVANCES, CELLS_A_WORD, TURNS, FootprintTable, unpacked
from zsdist.planning.grid import HEADINGS, STEPS
from zsdist.types import LatticeState

_STEPS = np.asarray(STEPS)
_TURNS = np.array(TURNS)
_MOVING = sum(ADVANCES)  # actions that end in another cell come first
assert ADVANCES == (1,) * _MOVING + (0,) * (ACTIONS - _MOVING)


class BlockedMoves:
    """What is blocked on one map.

    Args:
        words: `(8, 5, words, cells)`, by heading, action, word of a row, row.
    """

    def __init__(self, words: np.ndarray) -> None:
        self.words = words

    @classmethod
    def of(cls, blocked: np.ndarray) -> "BlockedMoves":
        """Of an array such as `blocked` is."""
        cells = len(blocked)
        words = ~packed_states(~blocked.reshape(cells, cells, -1))
        return cls(words.reshape(HEADINGS, ACTIONS, -1, cells))

    @classmethod
    def on(cls, occupancy: np.ndarray, table: FootprintTable) -> "BlockedMoves":
        """Where squares are occupied, of `squares.rows`."""
        return cls(table.words(occupancy).reshape(HEADINGS, ACTIONS, -1, table.grid.cells))

    @cached_property
    def blocked(self) -> np.ndarray:
        """`[iy, ix, heading, action]` `(cells, cells, 8, 5)` bool."""
        cells = self.words.shape[-1]
        return unpacked(self.words.reshape(HEADINGS * ACTIONS, -1, cells)).reshape(cells, cells, HEADINGS, ACTIONS)

    def at(self, state: LatticeState) -> np.ndarray:
        """What is blocked in one state, `(5,)` bool."""
        words = self.words[state.heading, :, state.ix // CELLS_A_WORD, state.iy].tolist()
        return np.array([word >> state.ix % CELLS_A_WORD & 1 for word in words], np.bool_)

    def among(self, states: np.ndarray, others: "BlockedMoves") -> "BlockedMoves":
        """These of some states, and `others` of all other states."""
        differ = (self.words ^ others.words) & states[:, None]
        return BlockedMoves(others.words ^ differ)

    def states_to(self, packed_cells: np.ndarray) -> np.ndarray:
        """States from which a free way leads to one of some places; those in such a place are among them."""
        return _states_to(self.words, packed_cells)

    def leaving(self, states: np.ndarray) -> "BlockedMoves":
        """With it blocked what ends outside a set of states."""
        return BlockedMoves(_leaving(self.words, states))


@compiled()
def packed_states(flags: np.ndarray) -> np.ndarray:
    """Words `(planes, words, cells)` of `(cells, cells, planes)` bool; 0 beyond a row's last cell."""
    rows, columns, planes = flags.shape
    words = np.zeros((planes, (columns - 1) // CELLS_A_WORD + 1, rows), np.uint64)
    for iy in range(rows):
        for ix in range(columns):
            bit = np.uint64(ix % CELLS_A_WORD)
            for plane in range(planes):
                words[plane, ix // CELLS_A_WORD, iy] |= np.uint64(flags[iy, ix, plane]) << bit
    return words


def packed_cells(mask: np.ndarray) -> np.ndarray:
    """Places `(words, cells)` of a mask `[iy, ix]` `(cells, cells)` bool."""
    return np.ascontiguousarray(bitmaps.packed_rows(mask).T)


def contains(states: np.ndarray, state: LatticeState) -> bool:
    """Whether a state is one of a set."""
    word = int(states[state.heading, state.ix // CELLS_A_WORD, state.iy])
    return bool(word >> state.ix % CELLS_A_WORD & 1)


@compiled()
def _arriving(states: np.ndarray, heading: int, out: np.ndarray) -> None:
    """Cells from which an advance ends in one of the states, of one heading; both with a border of zeros about them."""
    dx, dy = _STEPS[heading]
    one, rest = np.uint64(1), np.uint64(CELLS_A_WORD - 1)
    for word in range(1, states.shape[0] - 1):
        for row in range(1, states.shape[1] - 1):
            here = states[word, row + dy]
            if dx > 0:
                here = here >> one | states[word + 1, row + dy] << rest
            elif dx < 0:
                here = here << one | states[word - 1, row + dy] >> rest
            out[word, row] = here


@compiled()
def _grow(states: np.ndarray, from_where: np.ndarray, blocked: np.ndarray) -> bool:
    """Adds to states of one heading those from where an action is not blocked; whether there were any new ones."""
    grown = np.uint64(0)
    for word in range(1, states.shape[0] - 1):
        for row in range(1, states.shape[1] - 1):
            new = from_where[word, row] & ~blocked[word - 1, row - 1] & ~states[word, row]
            states[word, row] |= new
            grown |= new
    return grown != 0


@compiled()
def _states_to(blocked: np.ndarray, packed_cells: np.ndarray) -> np.ndarray:
    words, rows = packed_cells.shape
    found = np.zeros((HEADINGS, words + 2, rows + 2), np.uint64)
    for heading in range(HEADINGS):
        found[heading, 1:-1, 1:-1] = packed_cells
    from_where, waiting = np.zeros((words + 2, rows + 2), np.uint64), np.ones(HEADINGS, np.bool_)
    while waiting.any():
        for end in range(HEADINGS):  # of actions that turn to it
            if not waiting[end]:
                continue
            waiting[end] = False
            _arriving(found[end], end, from_where)
            while _grow(found[end], from_where, blocked[end, 0]):  # straight on as far as it goes
                _arriving(found[end], end, from_where)
            for action in range(1, ACTIONS):
                heading = (end - _TURNS[action]) % HEADINGS
                before = from_where if action < _MOVING else found[end]
                waiting[heading] |= _grow(found[heading], before, blocked[heading, action])
    return found[:, 1:-1, 1:-1].copy()


@compiled()
def _leaving(blocked: np.ndarray, states: np.ndarray) -> np.ndarray:
    _, words, rows = states.shape
    inside, from_where = np.zeros((words + 2, rows + 2), np.uint64), np.zeros((words + 2, rows + 2), np.uint64)
    out = blocked.copy()
    for end in range(HEADINGS):
        inside[1:-1, 1:-1] = states[end]
        _arriving(inside, end, from_where)
        for action in range(ACTIONS):
            before = from_where if action < _MOVING else inside
            heading = (end - _TURNS[action]) % HEADINGS
            out[heading, action] |= ~before[1:-1, 1:-1]
    return out
