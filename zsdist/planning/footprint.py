"""Footprints of the car's moves on the fine grid: one table for shield, planner, solvability check and shortest paths.

The footprint of a move is the set of fine cells that the car's body sweeps. It is the union of at most two sweeps, each
an eighth of a turn in place or an advance by one cell.
"""

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
TURNS = (0, 1, -1, 2, -2)  # turn of each action in eighths of a full turn, counter-clockwise
ADVANCES = (1, 1, 1, 0, 0)  # cells that each action advances after its turn
_STEPS = [tuple(step) for step in STEPS.tolist()]  # plain numbers: to read them from an array takes ten times as long

CELLS_PER_WORD = 64  # cells of a row in one word of bits
_BATCH_CELLS = 32  # cells of a row that are tested together: their surroundings fit into a word of 64 bits
_FARTHEST = FINE_PER_CELL * (64 - _BATCH_CELLS) // 2  # fine cells on each side that fit into that word
_TURN_SAMPLE_RAD = math.radians(0.5)  # between samples the arc of a corner is at most 0.01 mm from its chord


def successor(state: LatticeState, action: int) -> LatticeState:
    """Return the state in which an action ends, possibly off the grid: first the turn in place, then the advance."""
    heading = (state.heading + TURNS[action]) % HEADINGS
    if not ADVANCES[action]:
        return LatticeState(state.ix, state.iy, heading)
    dx, dy = _STEPS[heading]
    return LatticeState(state.ix + dx, state.iy + dy, heading)


class FootprintTable:
    """Fine cells that the car's box, grown by a margin, touches in each action from each heading.

    The centre of a cell is a corner of four fine cells, so one list of offsets serves every cell.

    Args:
        grid: planning grid and fine grid.
        margin_m: width added on every side of the box.
        length_m: length of the car, along its heading.
        width_m: width of the car.

    Raises:
        ValueError: the car is too long for the table.
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
            raise ValueError(f"the car reaches {reach_m:.2f} m in one move; allowed is {most_m:.2f} m at most")
        self._sweeps = [self._advance(heading, *half) for heading in range(HEADINGS)]
        self._sweeps += [self._turn(heading, *half) for heading in range(HEADINGS)]
        self._sweeps_of = np.array([_sweeps_of(heading, action) for heading in range(HEADINGS) for action in Action])
        self._runs = _runs(self._sweeps)
        self._off_grid = self._ends_off_grid()
        # Window of the fine grid that begins `_reach` fine cells south-west of the centre of cell (0, 0).
        across = FINE_PER_CELL * _BATCH_CELLS * math.ceil(grid.cells / _BATCH_CELLS)
        self._window_first = grid.fine_border + FINE_PER_CELL // 2 - self._reach
        self._window_rows = FINE_PER_CELL * grid.cells + 2 * self._reach
        self._window_words = across // bitmaps.FINE_CELLS_PER_WORD + math.ceil(
            2 * self._reach / bitmaps.FINE_CELLS_PER_WORD
        )

    def swept(self, heading: int, action: int) -> np.ndarray:
        """Return the footprint of an action, `(M, 2)` int: offsets (dx, dy) of fine cells.

        They are relative to the fine cell north-east of the start cell's centre.
        """
        sweeps = [self._sweeps[sweep] for sweep in _sweeps_of(heading, action)]
        return np.unique(np.concatenate(sweeps), axis=0)

    def blocked(self, occupancy: np.ndarray) -> np.ndarray:
        """Return which actions are blocked in which states.

        Args:
            occupancy: `[iy, ix]` `(fine_size, fine_size)` bool, fine cells that are not free.

        Returns:
            `[iy, ix, heading, action]` `(cells, cells, 8, 5)` bool: true where the footprint meets an occupied fine
            cell or leaves the arena, or where the action ends off the grid.

        Raises:
            ValueError: `occupancy` has another shape.
        """
        size, cells = self.grid.fine_size, self.grid.cells
        if occupancy.shape != (size, size):
            raise ValueError(f"occupancy has the shape {occupancy.shape}; allowed is {(size, size)}")
        return unpack_states(self.words(bitmaps.pack_rows(occupancy))).reshape(cells, cells, HEADINGS, ACTIONS)

    def words(self, occupancy: np.ndarray) -> np.ndarray:
        """Return the blocked actions as bits, `(8 * 5, words, cells)` uint64, by heading and action, word, row.

        Bit j of a row's word w is its cell `CELLS_PER_WORD * w + j`; bits beyond the last cell are set (blocked).

        Args:
            occupancy: bitmap of `bitmaps.pack_rows`, fine cells that are not free.
        """
        surroundings = bitmaps.window(occupancy, self._window_first, self._window_rows, self._window_words)
        return _blocked_words(surroundings, self._runs, self._sweeps_of, self._off_grid, self._reach)

    def _advance(self, heading: int, half_l: float, half_w: float) -> np.ndarray:
        """Return the sweep of an advance by one cell: one box as long as the distance and the car."""
        angle, (dx, dy) = heading * math.tau / HEADINGS, STEPS[heading] * self.grid.cell_size_m
        return self._touched([(dx / 2, dy / 2, angle, half_l + math.hypot(dx, dy) / 2, half_w)])

    def _turn(self, heading: int, half_l: float, half_w: float) -> np.ndarray:
        """Return the sweep of an eighth of a turn in place from a heading to the left, or back: a fan of boxes."""
        begin, eighth = heading * math.tau / HEADINGS, math.tau / HEADINGS
        fan = np.linspace(begin, begin + eighth, math.ceil(eighth / _TURN_SAMPLE_RAD) + 1)
        return self._touched([(0.0, 0.0, float(angle), half_l, half_w) for angle in fan])

    def _touched(self, boxes: list[tuple[float, float, float, float, float]]) -> np.ndarray:
        """Return offsets `(M, 2)` of fine cells that any box `(x, y, heading, half length, half width)` overlaps."""
        fine_m = self.grid.fine_m
        offsets = np.arange(-self._reach, self._reach)
        centres = (offsets + 0.5) * fine_m
        touched = np.zeros((len(offsets), len(offsets)), dtype=bool)  # [dy, dx]
        for x, y, heading, half_l, half_w in boxes:
            cos, sin = math.cos(heading), math.sin(heading)
            dx, dy = centres[None, :] - x, centres[:, None] - y
            grow = fine_m / 2 * (abs(cos) + abs(sin))
            wide, high = abs(cos) * half_l + abs(sin) * half_w, abs(sin) * half_l + abs(cos) * half_w
            touched |= (  # two rectangles overlap if none of their four axes separates them
                (np.abs(dx * cos + dy * sin) < half_l + grow)
                & (np.abs(dy * cos - dx * sin) < half_w + grow)
                & (np.abs(dx) < wide + fine_m / 2)
                & (np.abs(dy) < high + fine_m / 2)
            )
        rows, columns = np.nonzero(touched)
        return np.stack([offsets[columns], offsets[rows]], axis=1)

    def _ends_off_grid(self) -> np.ndarray:
        """Return the actions that end off the grid, in the form of `words`."""
        cells = self.grid.cells
        columns = CELLS_PER_WORD * math.ceil(cells / CELLS_PER_WORD)
        iy, ix = np.indices((cells, columns))
        off = np.zeros((HEADINGS * ACTIONS, columns // CELLS_PER_WORD, cells), np.uint64)
        for heading in range(HEADINGS):
            for action in range(ACTIONS):
                dx, dy, _ = successor(LatticeState(0, 0, heading), action)
                inside = (ix < cells) & (ix + dx >= 0) & (ix + dx < cells) & (iy + dy >= 0) & (iy + dy < cells)
                bits = (~inside).reshape(cells, -1, CELLS_PER_WORD) << np.arange(CELLS_PER_WORD, dtype=np.uint64)
                off[heading * ACTIONS + action] = np.bitwise_or.reduce(bits, -1).T
        return off


def _sweeps_of(heading: int, action: int) -> tuple[int, int]:
    """Return the two sweeps whose union is an action's footprint; they may be the same.

    Sweep `heading` is an advance, sweep `HEADINGS + heading` an eighth of a turn from that heading to its left.
    """
    turn, end = TURNS[action], (heading + TURNS[action]) % HEADINGS
    first = heading if turn >= 0 else heading - 1
    eighths = [HEADINGS + (first + (k if turn > 0 else -k)) % HEADINGS for k in range(abs(turn))]
    parts = eighths + [end] * ADVANCES[action]
    return parts[0], parts[-1]


def _runs(sweeps: list[np.ndarray]) -> np.ndarray:
    """Return sweeps as runs of fine cells along x, `(runs, 5)` int32.

    A run is the union of two windows of `2**k` fine cells. The columns are the number of the sweep, dy, dx at which
    the first window begins, dx at which the last window begins, and k.
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
def _every_fourth(word: np.uint64) -> np.uint64:
    """Return bits 0, 4, 8, ... of a word, packed side by side."""
    bits = word & np.uint64(0x1111111111111111)
    bits = (bits | bits >> np.uint64(3)) & np.uint64(0x0303030303030303)
    bits = (bits | bits >> np.uint64(6)) & np.uint64(0x000F000F000F000F)
    bits = (bits | bits >> np.uint64(12)) & np.uint64(0x000000FF000000FF)
    return (bits | bits >> np.uint64(24)) & np.uint64(0xFFFF)


@compiled()
def _blocked_words(
    surroundings: np.ndarray, runs: np.ndarray, sweeps_of: np.ndarray, off_grid: np.ndarray, reach: int
) -> np.ndarray:
    """Return where each footprint meets an occupied fine cell or ends off the grid.

    `_BATCH_CELLS` cells of a row are tested together. Bit j of a word (row, phase) is column 4 j + phase of their
    surroundings, so that a shift by one bit moves on by one cell. The words of doubling k hold windows: a bit is set
    if any of the `2**k` fine cells from there on is occupied. A run of fine cells is the union of two windows.

    Args:
        surroundings: bitmap of the occupied fine cells, `reach` of them around the grid included.
        runs: runs of the sweeps, from `_runs`.
        sweeps_of: `(footprints, 2)`, the sweeps of each footprint.
        off_grid: `(footprints, words, cells)`, actions that end off the grid.
        reach: greatest offset of a sweep, in fine cells.

    Returns:
        `(footprints, words, cells)`, of `CELLS_PER_WORD` cells each.
    """
    rows, cells = len(surroundings), off_grid.shape[2]
    doublings = runs[:, 4].max() + 1
    # Rows that are one cell apart are stored side by side: one of them is under each cell of a column.
    words = np.empty((doublings, FINE_PER_CELL, FINE_PER_CELL, (rows - 1) // FINE_PER_CELL + 1), np.uint64)
    blocked = off_grid.copy()
    for left in range(0, cells, _BATCH_CELLS):
        first = FINE_PER_CELL * left // 64  # word of the surroundings of these cells
        last = first + (FINE_PER_CELL * _BATCH_CELLS + 2 * reach - 1) // 64
        for y in range(rows):
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
        for footprint in range(len(off_grid)):
            column = blocked[footprint, left // CELLS_PER_WORD]
            one, other = met[sweeps_of[footprint, 0]], met[sweeps_of[footprint, 1]]
            for iy in range(cells):
                batch = (one[iy] | other[iy]) & np.uint64(2**_BATCH_CELLS - 1)
                column[iy] |= batch << np.uint64(left % CELLS_PER_WORD)
    return blocked


@compiled()
def unpack_states(words: np.ndarray) -> np.ndarray:
    """Return bits `(planes, words, cells)` as `(cells, cells, planes)` bool; inverse of `reachability.pack_states`."""
    planes, _, cells = words.shape
    flags, row = np.empty((cells, cells, planes), np.bool_), np.empty(planes, np.uint64)
    for iy in range(cells):
        for ix in range(cells):
            bit = np.uint64(ix % CELLS_PER_WORD)
            if bit == 0:
                row[:] = words[:, ix // CELLS_PER_WORD, iy]
            for plane in range(planes):
                flags[iy, ix, plane] = (row[plane] >> bit) & np.uint64(1)
    return flags
