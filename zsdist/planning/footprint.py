"""Where the car's body sweeps: one table for shield, planner, solvability check and shortest paths."""

import math

import numpy as np
from numba import njit

from zsdist.planning.grid import FINE_PER_CELL, HEADINGS, STEPS, Grid
from zsdist.types import Action, LatticeState

CAR_LENGTH_M = 2.04  # cabinet and wheels (Table 1 and the wheels' overhang)
CAR_WIDTH_M = 1.09
MARGIN_M = 0.10
ACTIONS = len(Action)
TURNS = (0, 1, -1, 2, -2)  # eighths of a turn, counter-clockwise, of each action
ADVANCES = (1, 1, 1, 0, 0)  # cells moved after the turn

_HALF_WINDOW = 32  # squares on each side of the car that fit into the bits of a row's window
_TURN_SAMPLE_RAD = math.radians(0.5)  # the arc of a corner between samples leaves its chord by 0.01 mm


def successor(state: LatticeState, action: int) -> LatticeState:
    """Where an action ends, possibly off the grid: first the turn in place, then the advance."""
    heading = (state.heading + TURNS[action]) % HEADINGS
    dx, dy = STEPS[heading] * ADVANCES[action]
    return LatticeState(state.ix + int(dx), state.iy + int(dy), heading)


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
        if self._reach > _HALF_WINDOW:
            most_m = _HALF_WINDOW * grid.fine_m
            raise ValueError(f"the car with one step reaches {reach_m:.2f} m; allowed is {most_m:.2f} m")
        headings = range(HEADINGS)
        self._swept = [[self._sweep(heading, action, *half) for action in range(ACTIONS)] for heading in headings]
        self._standing = [self._touched([(0.0, 0.0, heading * math.tau / HEADINGS, *half)]) for heading in headings]
        self._swept_masks = self._masks([offsets for row in self._swept for offsets in row])
        self._standing_masks = self._masks(self._standing)
        self._off_grid = self._ends_off_grid()

    def end(self, state: LatticeState, action: int) -> LatticeState:
        """Where an action ends, possibly off the grid."""
        return successor(state, action)

    def swept(self, heading: int, action: int) -> np.ndarray:
        """Squares swept by an action, `(M, 2)` int: (dx, dy) from the square north-east of the start cell's centre."""
        return self._swept[heading][action]

    def standing(self, heading: int) -> np.ndarray:
        """Squares covered by the car at rest, `(M, 2)` int, offsets as in `swept`."""
        return self._standing[heading]

    def blocked(self, occupancy: np.ndarray) -> np.ndarray:
        """Which action from which state is not to be taken.

        Args:
            occupancy: `[iy, ix]` `(fine_size, fine_size)` bool, squares that are not free.

        Returns:
            `[iy, ix, heading, action]` `(cells, cells, 8, 5)` bool: true where the swept squares touch occupied ones
            or leave the arena, or where the action ends off the grid.
        """
        cells = self.grid.cells
        hits = self._hits(occupancy, self._swept_masks).reshape(cells, cells, HEADINGS, ACTIONS)
        return np.logical_or(hits, self._off_grid, out=hits)

    def state_blocked(self, occupancy: np.ndarray) -> np.ndarray:
        """In which states the car cannot stand, `[iy, ix, heading]` `(cells, cells, 8)` bool; margin included."""
        return self._hits(occupancy, self._standing_masks)

    def _hits(self, occupancy: np.ndarray, masks: np.ndarray) -> np.ndarray:
        size = self.grid.fine_size
        if occupancy.shape != (size, size):
            raise ValueError(f"occupancy has the shape {occupancy.shape}; allowed is {(size, size)}")
        occupied = np.ascontiguousarray(occupancy, dtype=np.bool_)
        return _hits(occupied, masks, self.grid.cells, self.grid.fine_border, self._reach)

    def _sweep(self, heading: int, action: int, half_l: float, half_w: float) -> np.ndarray:
        """The turn as a fan of boxes, the advance as one box as long as the way and the car."""
        begin, turn = heading * math.tau / HEADINGS, TURNS[action] * math.tau / HEADINGS
        samples = math.ceil(abs(turn) / _TURN_SAMPLE_RAD)
        fan = np.linspace(begin, begin + turn, samples + 1)
        boxes = [(0.0, 0.0, float(angle), half_l, half_w) for angle in fan]
        if ADVANCES[action]:
            dx, dy = STEPS[(heading + TURNS[action]) % HEADINGS] * self.grid.cell_size_m
            boxes.append((dx / 2, dy / 2, begin + turn, half_l + math.hypot(dx, dy) / 2, half_w))
        return self._touched(boxes)

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

    def _masks(self, footprints: list[np.ndarray]) -> np.ndarray:
        """Footprints as bits, `(footprints, 2 reach)` uint64: bit `dx + 32` of row `dy + reach`."""
        masks = np.zeros((len(footprints), 2 * self._reach), dtype=np.uint64)
        for row, offsets in zip(masks, footprints, strict=True):
            bits = np.left_shift(np.uint64(1), (offsets[:, 0] + _HALF_WINDOW).astype(np.uint64))
            np.bitwise_or.at(row, offsets[:, 1] + self._reach, bits)
        return masks

    def _ends_off_grid(self) -> np.ndarray:
        cells = self.grid.cells
        off = np.zeros((cells, cells, HEADINGS, ACTIONS), dtype=bool)
        iy, ix = np.indices((cells, cells))
        for heading in range(HEADINGS):
            for action in range(ACTIONS):
                dx, dy, _ = successor(LatticeState(0, 0, heading), action)
                inside = (ix + dx >= 0) & (ix + dx < cells) & (iy + dy >= 0) & (iy + dy < cells)
                off[:, :, heading, action] = ~inside
        return off


@njit(cache=True)
def _hits(occupied: np.ndarray, masks: np.ndarray, cells: int, border: int, reach: int) -> np.ndarray:
    """Which footprint at which cell meets an occupied square, `(cells, cells, footprints)` bool.

    A row of the surroundings of a cell is 64 bits wide, so a footprint is compared a row at a time.
    """
    size = occupied.shape[0]
    footprints, rows = masks.shape
    windows = np.empty((size, cells), dtype=np.uint64)
    for fy in range(size):
        for ix in range(cells):
            first = border + FINE_PER_CELL * ix + FINE_PER_CELL // 2 - reach
            bits = np.uint64(0)
            for step in range(2 * reach):
                fx = first + step
                if fx < 0 or fx >= size or occupied[fy, fx]:
                    bits |= np.uint64(1) << np.uint64(step + _HALF_WINDOW - reach)
            windows[fy, ix] = bits
    every = ~np.uint64(0)
    hits = np.zeros((cells, cells, footprints), dtype=np.bool_)
    near = np.empty(rows, dtype=np.uint64)
    for iy in range(cells):
        first = border + FINE_PER_CELL * iy + FINE_PER_CELL // 2 - reach
        for ix in range(cells):
            some = np.uint64(0)
            for row in range(rows):
                fy = first + row
                near[row] = windows[fy, ix] if 0 <= fy < size else every
                some |= near[row]
            if some == 0:
                continue
            for footprint in range(footprints):
                for row in range(rows):
                    if near[row] & masks[footprint, row]:
                        hits[iy, ix, footprint] = True
                        break
    return hits
