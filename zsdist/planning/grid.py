"""The planning grid: cells, blocks and lattice headings, and the fine grid on which occupied space is stored."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zsdist.config import GridConfig
from zsdist.errors import ConfigError
from zsdist.types import LatticeState, Pose

HEADINGS = 8  # heading k points k * 45 degrees counter-clockwise from east
STEPS = np.array([(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)])  # `(8, 2)` cells (dx, dy)
FINE_PER_CELL = 4  # fine cells along the side of a cell


@dataclass(frozen=True)
class Grid:
    """The two planning grids in the middle of the arena, and the fine grid over the whole arena.

    Eq. (7): the low-level states are the cells `(ix, iy)` of an `m x m` grid. The high-level states are the blocks of
    `m / blocks` cells a side. Cell `(0, 0)` is the south-western one; the paper counts from 1, we from 0.

    The fine grid has cells of a quarter of a cell's side. They are indexed `[iy, ix]` from the south-western corner of
    the arena, and the edges of cells are edges of fine cells.

    Attributes:
        cells: cells per side, `m`.
        blocks: blocks per side.
        cell_size_m: side of a cell, in metres.
        arena_m: side of the walled arena, in metres; it has the same centre as the grid.

    Raises:
        ConfigError: the sizes do not fit together.
    """

    cells: int = 32
    blocks: int = 4
    cell_size_m: float = 0.625
    arena_m: float = 25.0

    def __post_init__(self) -> None:
        border = (self.arena_m - self.side_m) / 2 / self.fine_m
        if border < 0 or abs(border - round(border)) > 1e-6:
            raise ConfigError(
                f"grid.arena_m is {self.arena_m}; allowed is the grid's side, {self.side_m} m, "
                f"plus a multiple of {2 * self.fine_m} m"
            )
        if self.cells % self.blocks:
            raise ConfigError(f"grid.cells is {self.cells}; allowed are multiples of grid.blocks, {self.blocks}")

    @classmethod
    def from_config(cls, config: GridConfig) -> "Grid":
        """Return the grid of a configuration; raise `ConfigError` if its sizes do not fit together."""
        return cls(config.cells, config.blocks, config.cell_size_m, config.arena_m)

    @cached_property
    def side_m(self) -> float:
        """Side of the planning grid, in metres."""
        return self.cells * self.cell_size_m

    @cached_property
    def block_size(self) -> int:
        """Number of cells along the side of a block."""
        return self.cells // self.blocks

    @cached_property
    def fine_m(self) -> float:
        """Side of a fine cell, in metres."""
        return self.cell_size_m / FINE_PER_CELL

    @cached_property
    def fine_size(self) -> int:
        """Number of fine cells per side of the arena."""
        return round(self.arena_m / self.fine_m)

    @cached_property
    def fine_border(self) -> int:
        """Number of fine cells between the arena's wall and the first cell."""
        return (self.fine_size - FINE_PER_CELL * self.cells) // 2

    def contains(self, x_m: float, y_m: float) -> bool:
        """Return whether a point lies on the planning grid; its western and southern edges belong to it."""
        half = self.side_m / 2
        return -half <= x_m < half and -half <= y_m < half

    def cell_at(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Return the cell `(ix, iy)` in which a point lies.

        Raises:
            ValueError: the point is off the grid.
        """
        half = self.side_m / 2
        if not self.contains(x_m, y_m):
            raise ValueError(f"point ({x_m}, {y_m}) is off the grid; allowed is -{half} to below {half} m")
        last = self.cells - 1  # a point just below the upper edge may round up to `cells`
        return (
            min(int((x_m + half) / self.cell_size_m), last),
            min(int((y_m + half) / self.cell_size_m), last),
        )

    def centre(self, ix: int, iy: int) -> tuple[float, float]:
        """Return the centre `(x_m, y_m)` of a cell; the cell may lie beyond the grid's edge."""
        half = self.side_m / 2
        return (ix + 0.5) * self.cell_size_m - half, (iy + 0.5) * self.cell_size_m - half

    def on_grid(self, ix: int, iy: int) -> bool:
        """Return whether `(ix, iy)` is a cell of the grid."""
        return 0 <= ix < self.cells and 0 <= iy < self.cells

    def block_of(self, ix: int, iy: int) -> tuple[int, int]:
        """Return the block `(bx, by)` to which a cell belongs."""
        return ix // self.block_size, iy // self.block_size

    def block_cells(self, bx: int, by: int) -> tuple[slice, slice]:
        """Return the cells of a block, as slices for arrays indexed `[iy, ix]`."""
        size = self.block_size
        return slice(by * size, (by + 1) * size), slice(bx * size, (bx + 1) * size)

    def lattice_state(self, pose: Pose) -> LatticeState:
        """Return the lattice state nearest to a pose; a pose off the grid gives a cell at its edge."""
        half, side, last = self.side_m / 2, self.cell_size_m, self.cells - 1
        ix = min(max(math.floor((pose.x_m + half) / side), 0), last)
        iy = min(max(math.floor((pose.y_m + half) / side), 0), last)
        return LatticeState(ix, iy, round(pose.heading_rad / (math.tau / HEADINGS)) % HEADINGS)

    def pose(self, state: LatticeState) -> Pose:
        """Return the pose of a lattice state, with a heading in (-pi, pi]."""
        x_m, y_m = self.centre(state.ix, state.iy)
        eighths = state.heading if state.heading <= HEADINGS // 2 else state.heading - HEADINGS
        return Pose(x_m, y_m, eighths * math.tau / HEADINGS)

    def fine_index(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Return the fine cell `(fx, fy)` in which a point lies; outside the arena its indices are out of range."""
        half = self.arena_m / 2
        return math.floor((x_m + half) / self.fine_m), math.floor((y_m + half) / self.fine_m)

    def fine_centres(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the centres of fine cells along each axis: `xs (fine_size,)`, `ys (fine_size,)` in metres."""
        centres = (np.arange(self.fine_size) + 0.5) * self.fine_m - self.arena_m / 2
        return centres, centres.copy()

    def cell_centres(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the centres of cells along each axis: `xs (cells,)`, `ys (cells,)` in metres."""
        centres = (np.arange(self.cells) + 0.5) * self.cell_size_m - self.side_m / 2
        return centres, centres.copy()
