"""Where the car's body sweeps: one table for shield, planner, solvability check and shortest paths."""

import math

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.planning import bitmaps
from zsdist.planning.grid import FINE_PER_CELL, HEADINGS, STEPS, Grid
from zsdist.types import Action, LatticeState

CAR_LENGTH_M = 2.04  # cabinet and wheels (Table 1 and the wheels' overhang)
CAR_WIDTH_M = 1.09
MARGIN_M = 0.10
ACTIONS = len(Action)
TURNS = (0, 1, -1, 2, -2)  # eighths of a turn, counter-clockwise, of each action
ADVANCES = (1, 1, 1, 0, 0)  # cells moved after the turn
_STEPS = [tuple(step) for step in STEPS.tolist()]  # plain numbers: an array's take ten times as long to get at

CELLS_A_WORD = 64  # of a row, where footprints are kept as bits
_AT_ONCE = 32  # cells of a row whose surroundings share a word of 64 bits
_FARTHEST = FINE_PER_CELL * (64 - _AT_ONCE) // 2  # squares on each side that fit into it
_TURN_SAMPLE_RAD = math.radians(0.5)  # the arc of a corner between samples leaves its chord by 0.01 mm


def successor(state: LatticeState, action: int) -> LatticeState:
    """Where an action ends, possibly off the grid: first the turn in place, then the advance."""
    heading = (state.heading + TURNS[action]) % HEADINGS
    if not ADVANCES[action]:
        return LatticeState(state.ix, state.iy, heading)
    dx, dy = _STEPS[heading]
    return LatticeState(state.ix + dx, state.iy + dy, heading)


class FootprintTable:
    """Squares of the fine frame that the car's box, grown by a margin, touches in each action from each heading.

    The centre of a cell is a corner of the fine frame, so one list of offsets serves every cell.

    Args:
        grid: the frames.
        margin_m: added on every side of the box.
        length_m: of the car, along its heading.
        width_m: of the car.
    """

    def __init__(
        self,
        grid: Grid,
        margin_m: float = MARGIN_M,
        length_m: float = CAR_LENGTH_M,
        width_m: float = CAR_WIDTH_M,
    ) -> None:
        self.grid = grid
        half = (length_m / 2 + margin_m, width_m / 2 + margin_m)
        reach_m = math.hypot(*half) + math.sqrt(2) * grid.cell_size_m
        self._reach = math.ceil(reach_m / grid.fine_m)
        if self._reach > _FARTHEST:
            most_m = _FARTHEST * grid.fine_m
            raise ValueError(f"the car with one step reaches {reach_m:.2f} m; allowed is {most_m:.2f} m")
        self._sweeps = [self._advance(heading, *half) for heading in range(HEADINGS)]
        self._sweeps += [self._turn(heading, *half) for heading in range(HEADINGS)]
        self._made_of = np.array([_made_of(heading, action) for heading in range(HEADINGS) for action in Action])
        self._runs = _runs(self._sweeps)
        self._off_grid = self._ends_off_grid()
        # From `_reach` squares south-west of the centre of cell (0, 0) on: the first row and column, rows, words.
        across = FINE_PER_CELL * _AT_ONCE * math.ceil(grid.cells / _AT_ONCE)
        self._surroundings = (
            grid.fine_border + FINE_PER_CELL // 2 - self._reach,
            FINE_PER_CELL * grid.cells + 2 * self._reach,
            across // bitmaps.SQUARES_A_WORD + math.ceil(2 * self._reach / bitmaps.SQUARES_A_WORD),
        )

    def swept(self, heading: int, action: int) -> np.ndarray:
        """Squares swept by an action, `(M, 2)` int: (dx, dy) from the square north-east of the start cell's centre."""
        sweeps = [self._sweeps[sweep] for sweep in _made_of(heading, action)]
        return np.unique(np.concatenate(sweeps), axis=0)

    def blocked(self, occupancy: np.ndarray) -> np.ndarray:
        """Which action from which state is not to be taken.

        Args:
            occupancy: `[iy, ix]` `(fine_size, fine_size)` bool, squares that are not free.

        Returns:
            `[iy, ix, heading, action]` `(cells, cells, 8, 5)` bool: true where the swept squares touch occupied ones
            or leave the arena, or where the action ends off the grid.
        """
        size, cells = self.grid.fine_size, self.grid.cells
        if occupancy.shape != (size, size):
            raise ValueError(f"occupancy has the shape {occupancy.shape}; allowed is {(size, size)}")
        return unpacked(self.words(bitmaps.packed_rows(occupancy))).reshape(cells, cells, HEADINGS, ACTIONS)

    def words(self, occupancy: np.ndarray) -> np.ndarray:
        """The same as bits, of `squares.rows`: `(8 * 5, words, cells)` uint64, by heading and action, word, row.

        Bit j of a row's word w is its cell `CELLS_A_WORD * w + j`; what lies beyond the last cell is not to be taken.
        """
        return _hits(
            bitmaps.window(occupancy, *self._surroundings), self._runs, self._made_of, self._off_grid, self._reach
        )

    def _advance(self, heading: int, half_l: float, half_w: float) -> np.ndarray:
        """A cell ahead: one box as long as the way and the car."""
        angle, (dx, dy) = heading * math.tau / HEADINGS, STEPS[heading] * self.grid.cell_size_m
        return self._touched([(dx / 2, dy / 2, angle, half_l + math.hypot(dx, dy) / 2, half_w)])

    def _turn(self, heading: int, half_l: float, half_w: float) -> np.ndarray:
        """An eighth of a turn to the left in place, or back: a fan of boxes."""
        begin, eighth = heading * math.tau / HEADINGS, math.tau / HEADINGS
        fan = np.linspace(begin, begin + eighth, math.ceil(eighth / _TURN_SAMPLE_RAD) + 1)
        return self._touched([(0.0, 0.0, float(angle), half_l, half_w) for angle in fan])

    def _touched(self, boxes: list[tuple[float, float, float, float, float]]) -> np.ndarray:
        """Offsets `(M, 2)` of the squares that any box `(x, y, heading, half length, half width)` overlaps."""
        square = self.grid.fine_m
        offsets = np.arange(-self._reach, self._reach)
        centres = (offsets + 0.5) * square
        touched = np.zeros((len(offsets), len(offsets)), dtype=bool)  # [dy, dx]
        for x, y, heading, half_l, half_w in boxes:
            cos, sin = math.cos(heading), math.sin(heading)
            dx, dy = centres[None, :] - x, centres[:, None] - y
            grow = square / 2 * (abs(cos) + abs(sin))
            wide, high = abs(cos) * half_l + abs(sin) * half_w, abs(sin) * half_l + abs(cos) * half_w
            touched |= (  # two rectangles overlap where none of their four axes separates them
                (np.abs(dx * cos + dy * sin) < half_l + grow)
                & (np.abs(dy * cos - dx * sin) < half_w + grow)
                & (np.abs(dx) < wide + square / 2)
                & (np.abs(dy) < high + square / 2)
            )
        rows, columns = np.nonzero(touched)
        return np.stack([offsets[columns], offsets[rows]], axis=1)

    def _ends_off_grid(self) -> np.ndarray:
        """Words as of `words`, of what ends off the grid."""
        cells = self.grid.cells
        columns = CELLS_A_WORD * math.ceil(cells / CELLS_A_WORD)
        iy, ix = np.indices((cells, columns))
        off = np.zeros((HEADINGS * ACTIONS, columns // CELLS_A_WORD, cells), np.uint64)
        for heading in range(HEADINGS):
            for action in range(ACTIONS):
                dx, dy, _ = successor(LatticeState(0, 0, heading), action)
                inside = (ix < cells) & (ix + dx >= 0) & (ix + dx < cells) & (iy + dy >= 0) & (iy + dy < cells)
                bits = (~inside).reshape(cells, -1, CELLS_A_WORD) << np.arange(CELLS_A_WORD, dtype=np.uint64)
                off[heading * ACTIONS + action] = np.bitwise_or.reduce(bits, -1).T
        return off


def _made_of(heading: int, action: int) -> tuple[int, int]:
    """The two sweeps that an action's is made of: `heading` is an advance, `HEADINGS + heading` a turn to its left."""
    turn, end = TURNS[action], (heading + TURNS[action]) % HEADINGS
    first = heading if turn >= 0 else heading - 1
    eighths = [HEADINGS + (first + (k if turn > 0 else -k)) % HEADINGS for k in range(abs(turn))]
    parts = eighths + [end] * ADVANCES[action]
    return parts[0], parts[-1]


def _runs(sweeps: list[np.ndarray]) -> np.ndarray:
    """Sweeps as runs of squares along x, `(runs, 5)` int32.

    Columns: which sweep; dy; dx where the run's first and its last window of `2**k` squares begin, which together
    are the run; k.
    """
    runs = []
    for sweep, offsets in enumerate(sweeps):
        for dy in np.unique(offsets[:, 1]):
            dxs = np.sort(offsets[offsets[:, 1] == dy, 0])
            for run in np.split(dxs, np.flatnonzero(np.diff(dxs) > 1) + 1):
                doublings = len(run).bit_length() - 1
                runs.append((sweep, dy, run[0], run[-1] + 1 - 2**doublings, doublings))
    return np.array(runs, np.int32)


@compiled()
def _every_fourth(squares: np.uint64) -> np.uint64:
    """Bits 0, 4, 8, ... of a word, side by side."""
    bits = squares & np.uint64(0x1111111111111111)
    bits = (bits | bits >> np.uint64(3)) & np.uint64(0x0303030303030303)
    bits = (bits | bits >> np.uint64(6)) & np.uint64(0x000F000F000F000F)
    bits = (bits | bits >> np.uint64(12)) & np.uint64(0x000000FF000000FF)
    return (bits | bits >> np.uint64(24)) & np.uint64(0xFFFF)


@compiled()
def _hits(surroundings: np.ndarray, runs: np.ndarray, made_of: np.ndarray, off: np.ndarray, reach: int) -> np.ndarray:
    """Which footprint, of two sweeps, at which cell meets an occupied square or is `off` anyway.

    Works on `_AT_ONCE` cells of a row together. Bit j of a word (row, phase) is column 4 j + phase of their
    surroundings, so that moving on by a cell is a shift by one bit. A run of squares is the union of two of the windows
    of 1, 2, 4, ... squares that the words of each doubling hold.

    Returns:
        `(footprints, words, cells)`, of `CELLS_A_WORD` cells each.
    """
    tall, cells = len(surroundings), off.shape[2]
    doublings = runs[:, 4].max() + 1
    # rows that are a cell apart lie together: one of them is under each cell of a column
    words = np.empty((doublings, FINE_PER_CELL, FINE_PER_CELL, (tall - 1) // FINE_PER_CELL + 1), np.uint64)
    hits = off.copy()
    for left in range(0, cells, _AT_ONCE):
        first = FINE_PER_CELL * left // 64  # word of the surroundings of these cells
        last = first + (FINE_PER_CELL * _AT_ONCE + 2 * reach - 1) // 64
        for y in range(tall):
            for phase in range(FINE_PER_CELL):
                word = np.uint64(0)
                for part in range(first, last + 1):
                    word |= _every_fourth(surroundings[y, part] >> np.uint64(phase)) << np.uint64(16 * (part - first))
                words[0, phase, y % FINE_PER_CELL, y // FINE_PER_CELL] = word
        for k in range(1, doublings):
            step = 1 << (k - 1)
            for phase in range(FINE_PER_CELL):
                other, shift = (phase + step) % FINE_PER_CELL, np.uint64((phase + step) // FINE_PER_CELL)
                words[k, phase] = words[k - 1, phase] | (words[k - 1, other] >> shift)
        met = np.zeros((runs[:, 0].max() + 1, cells), np.uint64)  # by sweep
        for run in range(len(runs)):
            y, k = reach + runs[run, 1], runs[run, 4]
            under = met[runs[run, 0]]
            for end in range(2, 4):
                x = reach + runs[run, end]
                source = words[k, x % FINE_PER_CELL, y % FINE_PER_CELL, y // FINE_PER_CELL :]
                shift = np.uint64(x // FINE_PER_CELL)
                for iy in range(cells):
                    under[iy] |= source[iy] >> shift
        for footprint in range(len(off)):
            of_these = hits[footprint, left // CELLS_A_WORD]
            one, other = met[made_of[footprint, 0]], met[made_of[footprint, 1]]
            for iy in range(cells):
                these = (one[iy] | other[iy]) & np.uint64(2**_AT_ONCE - 1)
                of_these[iy] |= these << np.uint64(left % CELLS_A_WORD)
    return hits


@compiled()
def unpacked(words: np.ndarray) -> np.ndarray:
    """Bits `(planes, words, cells)` as `(cells, cells, planes)` bool."""
    planes, _, cells = words.shape
    flags, row = np.empty((cells, cells, planes), np.bool_), np.empty(planes, np.uint64)
    for iy in range(cells):
        for ix in range(cells):
            bit = np.uint64(ix % CELLS_A_WORD)
            if bit == 0:
                row[:] = words[:, ix // CELLS_A_WORD, iy]
            for plane in range(planes):
                flags[iy, ix, plane] = (row[plane] >> bit) & np.uint64(1)
    return flags
