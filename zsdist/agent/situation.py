"""Knowledge of the agent at one step, on which it decides: pose, believed map and memory."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zsdist.planning.grid import Grid
from zsdist.planning.reachability import BlockedMoves
from zsdist.types import LatticeState


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
        tries: `(blocks, blocks)` int32, `[by, bx]`, number of options towards each block that ended outside it.
        goal_tries: number of options towards the goal that ended without reaching it.
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
    tries: np.ndarray
    goal_tries: int

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
