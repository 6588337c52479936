"""Knowledge of the agent at one step, on which it decides: pose, believed map and memory."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from zsdist.planning.grid import Grid
from zsdist.planning.reachability import BlockedMoves
from zsdist.types import LatticeState


@dataclass
class Tries:
    """Counts of the options of an episode that ended without reaching what they sought.

    Attributes:
        blocks: `(blocks, blocks)` int32, `[by, bx]`, number of options towards each block that ended outside it.
        goal: number of options towards the goal that ended without reaching it.
    """

    blocks: np.ndarray
    goal: int = 0

    @classmethod
    def none(cls, grid: Grid) -> Self:
        """Return the counts before the first option."""
        return cls(np.zeros((grid.blocks, grid.blocks), np.int32))

    def count(self, block: tuple[int, int] | None) -> None:
        """Count an option towards `block`, `(bx, by)`; None: the option sought the goal."""
        if block is None:
            self.goal += 1
        else:
            self.blocks[block[1], block[0]] += 1


@dataclass(frozen=True)
class Situation:
    """Knowledge of the car at one step. Maps are believed, never true.

    Attributes:
        grid: planning grid.
        state: lattice state of the car.
        goal: `(x_m, y_m)` of the goal.
        goals: `(cells, cells)` bool, the cells in which the goal is reached.
        advice: `(3,)` R_p for forward, left, right.
        occupied: `(fine_size, fine_size)` bool, fine cells that count as occupied.
        seen: `(fine_size, fine_size)` bool, fine cells that were seen.
        moves: blocked moves of the shield's judgement.
        gave_way: whether full care leaves the car no path to the goal.
        drive_m: `(cells, cells)` metres of the shortest free path into each cell, with a surcharge for turns; infinite
            where none leads there.
        visits: `(cells, cells, 8)` int32, number of times that the car was in each state, now included.
        block_visits: `(blocks, blocks)` int32, `[by, bx]`, number of times that it entered each block.
        tries: counts of the options that failed; they go on while the situation lasts.
    """

    grid: Grid
    state: LatticeState
    goal: tuple[float, float]
    goals: np.ndarray
    advice: np.ndarray
    occupied: np.ndarray
    seen: np.ndarray
    moves: BlockedMoves
    gave_way: bool
    drive_m: np.ndarray
    visits: np.ndarray
    block_visits: np.ndarray
    tries: Tries

    @cached_property
    def position(self) -> tuple[float, float]:
        """Centre of the car's cell, `(x_m, y_m)`."""
        return self.grid.centre(self.state.ix, self.state.iy)

    @cached_property
    def block(self) -> tuple[int, int]:
        """Block `(bx, by)` that the car is in."""
        return self.grid.block_of(self.state.ix, self.state.iy)

    @property
    def blocked(self) -> np.ndarray:
        """Blocked actions at each state, `(cells, cells, 8, 5)` bool."""
        blocked: np.ndarray = self.moves.blocked
        return blocked

    @cached_property
    def reachable(self) -> np.ndarray:
        """Cells to which a free path leads from the car, `(cells, cells)` bool."""
        reachable: np.ndarray = np.isfinite(self.drive_m)
        return reachable
