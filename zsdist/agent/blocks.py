"""The high level's choices: the neighbouring blocks in the order of the car's heading, and the goal itself."""

from dataclasses import dataclass

import numpy as np

from zsdist.agent import reach
from zsdist.agent.situation import Situation
from zsdist.planning.grid import HEADINGS, STEPS

NEIGHBOURS = HEADINGS  # choice k is the neighbour k eighths of a turn to the left of the car's heading
GOAL_CHOICE = NEIGHBOURS
HIGH_ACTIONS = NEIGHBOURS + 1


@dataclass(frozen=True)
class Choices:
    """What each of the `HIGH_ACTIONS` means in a situation.

    Attributes:
        mask: `(9,)` bool, choices that can be made: the block exists and a free way is believed to lead into it.
            The goal can always be chosen.
        exists: `(9,)` bool.
        blocks: `(9, 2)` int, (bx, by) of each neighbour; the goal's own block last.
        subgoals: `(9, 2)` metres: the cell of the block by which the straight lines from the car to it and from it to
            the goal are shortest, among those a free way leads to; the goal itself last.
        onward: `(9,)` in how many of the subgoal's headings a free way leads on to the goal without coming back into
            the block the car is in, as a share.
    """

    mask: np.ndarray
    exists: np.ndarray
    blocks: np.ndarray
    subgoals: np.ndarray
    onward: np.ndarray

    def index_of(self, block: tuple[int, int]) -> int | None:
        """The choice that means a neighbouring block; None where it is none."""
        for k in range(NEIGHBOURS):
            if self.exists[k] and tuple(self.blocks[k]) == block:
                return k
        return None


def choices(situation: Situation) -> Choices:
    """The choices from where the car is."""
    grid, (bx, by) = situation.grid, situation.block
    mask, exists = np.zeros(HIGH_ACTIONS, bool), np.zeros(HIGH_ACTIONS, bool)
    blocks, subgoals = np.zeros((HIGH_ACTIONS, 2), np.int64), np.zeros((HIGH_ACTIONS, 2))
    onward = np.zeros(HIGH_ACTIONS)
    detours, leading = _detours(situation), _leading_on(situation)
    for k in range(NEIGHBOURS):
        dx, dy = STEPS[(situation.state.heading + k) % HEADINGS]
        nx, ny = bx + int(dx), by + int(dy)
        blocks[k] = nx, ny
        if not (0 <= nx < grid.blocks and 0 <= ny < grid.blocks):
            continue
        exists[k] = True
        rows, columns = grid.block_cells(nx, ny)
        here = detours[rows, columns]
        nearest = int(here.argmin())
        mask[k] = np.isfinite(here.flat[nearest])
        cell = (columns.start + nearest % grid.block_size, rows.start + nearest // grid.block_size)
        subgoals[k] = grid.centre(*cell) if mask[k] else grid.centre(*_middle(grid, nx, ny))
        onward[k] = leading[cell[1], cell[0]].mean() if mask[k] else 0.0
    mask[GOAL_CHOICE] = exists[GOAL_CHOICE] = True
    blocks[GOAL_CHOICE] = grid.block_of(*grid.cell_at(*situation.goal))
    subgoals[GOAL_CHOICE] = situation.goal
    return Choices(mask, exists, blocks, subgoals, onward)


def _middle(grid, bx: int, by: int) -> tuple[int, int]:  # noqa: ANN001
    return bx * grid.block_size + grid.block_size // 2, by * grid.block_size + grid.block_size // 2


def _leading_on(situation: Situation) -> np.ndarray:
    """States `(cells, cells, 8)` bool from which a free way leads to the goal without the car's present block."""
    blocked = situation.blocked.copy()
    blocked[situation.grid.block_cells(*situation.block)] = True
    return reach.states_to(blocked, situation.goals)


def _detours(situation: Situation) -> np.ndarray:
    """Metres from the car to each cell and on to the goal in straight lines; infinite where no free way leads."""
    xs, ys = situation.grid.cell_centres()
    x, y = situation.place
    goal_x, goal_y = situation.goal
    away = np.hypot(xs[None, :] - x, ys[:, None] - y)
    on = np.hypot(xs[None, :] - goal_x, ys[:, None] - goal_y)
    # a little for the nearer cell, so that of equal detours the one at the near border is taken
    return np.where(situation.reachable, away * 1.05 + on, np.inf)
