"""Choices of the high level: the neighbouring blocks, counted from the car's heading, and the goal itself."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zsdist.agent.situation import Situation
from zsdist.common.compiled import compiled
from zsdist.planning import reachability
from zsdist.planning.footprint import CELLS_PER_WORD
from zsdist.planning.grid import HEADINGS, STEPS
from zsdist.planning.reachability import BlockedMoves

NEIGHBOURS = HEADINGS  # choice k is the neighbour k eighths of a turn to the left of the car's heading
GOAL_CHOICE = NEIGHBOURS
HIGH_ACTIONS = NEIGHBOURS + 1
_STEPS = np.asarray(STEPS)


@dataclass(frozen=True)
class Choices:
    """Meaning of each of the `HIGH_ACTIONS` in a situation.

    Attributes:
        mask: `(9,)` bool, choices that may be made: each block that exists and that a free path is believed to enter,
            and always the goal.
        exists: `(9,)` bool, blocks that lie on the grid.
        blocks: `(9, 2)` int, `(bx, by)` of each neighbour; the goal's own block last.
        subgoals: `(9, 2)` metres, the centre of one cell in each block; the goal itself last. The cell has the least
            sum of the path length to it and the straight distance from it to the goal, among the cells that a free
            path reaches. Cells from which a free path to the goal avoids the car's present block take precedence.
        onward: `(9,)` share of the subgoal's eight headings from which a free path to the goal avoids the car's
            present block.
    """

    mask: np.ndarray
    exists: np.ndarray
    blocks: np.ndarray
    subgoals: np.ndarray
    onward: np.ndarray

    def index_of(self, block: tuple[int, int]) -> int | None:
        """Return the index of the choice of a block `(bx, by)`; None where the block is no neighbour."""
        return self._indices.get(block)

    @cached_property
    def _indices(self) -> dict[tuple[int, int], int]:
        neighbours = zip(self.blocks.tolist(), self.exists[:NEIGHBOURS].tolist(), strict=False)
        return {(bx, by): k for k, ((bx, by), exists) in enumerate(neighbours) if exists}


def choices(situation: Situation) -> Choices:
    """Return the choices of the high level in a situation."""
    grid, block = situation.grid, situation.block
    exists, blocks, subgoals, onward = _survey(
        situation.drive_m,
        _leading_on(situation),
        *block,
        situation.state.heading,
        *situation.goal,
        grid.block_size,
        grid.cell_size_m,
        grid.side_m / 2,
    )
    mask = exists & (onward >= 0)
    mask[GOAL_CHOICE] = exists[GOAL_CHOICE] = True
    blocks[GOAL_CHOICE] = grid.block_of(*grid.cell_at(*situation.goal))
    subgoals[GOAL_CHOICE] = situation.goal
    return Choices(mask, exists, blocks, subgoals, np.maximum(onward, 0.0))


def _leading_on(situation: Situation) -> np.ndarray:
    """Return the states from which a free path to the goal avoids the car's present block, `(8, words, cells)`."""
    here = np.zeros_like(situation.goals)
    here[situation.grid.block_cells(*situation.block)] = True
    elsewhere = BlockedMoves(situation.moves.words | reachability.pack_cells(here))
    return elsewhere.states_reaching(reachability.pack_cells(situation.goals))


@compiled()
def _headings(states: np.ndarray, ix: int, iy: int) -> np.uint64:
    """Return the number of headings in which a set of states contains a cell."""
    count = np.uint64(0)
    for heading in range(HEADINGS):
        count += states[heading, ix // CELLS_PER_WORD, iy] >> np.uint64(ix % CELLS_PER_WORD) & np.uint64(1)
    return count


@compiled()
def _survey(
    drive_m: np.ndarray,
    leading: np.ndarray,
    bx: int,
    by: int,
    heading: int,
    goal_x: float,
    goal_y: float,
    size: int,
    cell: float,
    half: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Survey the neighbouring blocks for `exists`, `blocks`, `subgoals` and `onward` of `Choices`.

    Args:
        drive_m: `(cells, cells)` lengths of the shortest free paths in metres, infinite where none leads.
        leading: `(8, words, cells)`, states from which a free path leads on to the goal.
        bx: column of the car's block.
        by: row of the car's block.
        heading: heading of the car, in eighths of a turn.
        goal_x: x of the goal, metres.
        goal_y: y of the goal, metres.
        size: cells along the side of a block.
        cell: side of a cell, metres.
        half: half the side of the grid, metres.

    Returns:
        The four arrays; `onward` is -1 where no free path leads into the block.
    """
    blocks_a_side = drive_m.shape[0] // size
    exists, blocks = np.zeros(HIGH_ACTIONS, np.bool_), np.zeros((HIGH_ACTIONS, 2), np.int64)
    subgoals, onward = np.zeros((HIGH_ACTIONS, 2)), np.full(HIGH_ACTIONS, -1.0)
    for k in range(NEIGHBOURS):
        nx, ny = bx + _STEPS[(heading + k) % HEADINGS, 0], by + _STEPS[(heading + k) % HEADINGS, 1]
        blocks[k, 0], blocks[k, 1] = nx, ny
        if not (0 <= nx < blocks_a_side and 0 <= ny < blocks_a_side):
            continue
        exists[k] = True
        least, most, ix, iy = np.inf, -1.0, nx * size + size // 2, ny * size + size // 2
        for row in range(ny * size, (ny + 1) * size):
            for column in range(nx * size, (nx + 1) * size):
                if drive_m[row, column] < np.inf:
                    cx, cy = (column + 0.5) * cell - half, (row + 0.5) * cell - half
                    # the path counts slightly more, so that the nearest of the cells with equal detours is taken
                    detour = drive_m[row, column] * 1.05 + math.hypot(cx - goal_x, cy - goal_y)
                    onwards = 1.0 if _headings(leading, column, row) else 0.0
                    if onwards > most or (onwards == most and detour < least):
                        least, most, ix, iy = detour, onwards, column, row
        subgoals[k, 0], subgoals[k, 1] = (ix + 0.5) * cell - half, (iy + 0.5) * cell - half
        if least < np.inf:
            onward[k] = _headings(leading, ix, iy) / HEADINGS
    return exists, blocks, subgoals, onward
