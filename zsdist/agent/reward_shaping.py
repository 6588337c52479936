"""Shaped rewards of both levels: progress along the believed path, and terms for events."""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from zsdist.planning.grid import Grid
from zsdist.planning.shortest_path import metres_cost
from zsdist.types import Action

# Rewards of a low-level step. The progress of a path through a block is worth about two.
PROGRESS_A_METRE = 0.5
STEP = -0.05
REVISIT = -0.1  # for each earlier visit of the state reached, up to MAX_REVISITS
MAX_REVISITS = 8
REENTRY = -0.3  # for each earlier visit of the block entered, up to MAX_REENTRIES; the high level only
MAX_REENTRIES = 4
GAVE_WAY = -0.2  # where full care leaves no path to the goal: not forbidden, but better avoided
ENTRY = 0.5
GOAL = 2.0
COLLISION = -4.0
TURN_45_M, TURN_90_M = 0.1, 0.4  # added to a path's length for each turn, so that turning towards it is progress
MAX_PROGRESS_M = 2.0  # a changed map can shorten a path by more, which the action did not cause


@cache
def path_costs(grid: Grid) -> np.ndarray:
    """Return the cost of each action by heading, `(8, 5)` metres with a surcharge for turns, read-only.

    Progress is measured in these costs.
    """
    costs = metres_cost(grid)
    costs[:, [Action.LEFT_45, Action.RIGHT_45]] += TURN_45_M
    costs[:, [Action.TURN_LEFT_90, Action.TURN_RIGHT_90]] += TURN_90_M
    costs.flags.writeable = False
    return costs


def progress_m(cost: np.ndarray, before: tuple[int, int, int], after: tuple[int, int, int]) -> float:
    """Return the metres by which the believed path to a target became shorter; 0 where no path leads there.

    Args:
        cost: `(cells, cells, 8)` metres to the target, on the map after the step.
        before: state before the step, `(iy, ix, heading)`.
        after: state after the step, likewise.
    """
    gained = float(cost[before]) - float(cost[after])
    return min(max(gained, -MAX_PROGRESS_M), MAX_PROGRESS_M) if math.isfinite(gained) else 0.0


@dataclass(frozen=True)
class Step:
    """Events of one low-level step, apart from progress.

    Attributes:
        revisits: number of earlier visits of the state reached.
        reentries: number of earlier visits of the block entered; 0 where the block is the same as before.
        gave_way: whether full care leaves no path to the goal where the step ended.
        reached: whether the goal was reached.
        collided: whether something was hit.
    """

    revisits: int
    reentries: int
    gave_way: bool
    reached: bool
    collided: bool

    def reward(self, progress_m: float) -> float:
        """Return the terms that both levels share: progress, step, revisits, squeezing, goal and collision."""
        reward = PROGRESS_A_METRE * progress_m + STEP + REVISIT * min(self.revisits, MAX_REVISITS)
        return reward + GAVE_WAY * self.gave_way + GOAL * self.reached + COLLISION * self.collided

    def low_reward(self, progress_m: float, entered: bool) -> float:
        """Return the reward of the low level.

        Args:
            progress_m: metres of progress towards its subgoal.
            entered: whether the step entered the block that the level was sent to.
        """
        return self.reward(progress_m) + ENTRY * entered

    def high_reward(self, progress_m: float) -> float:
        """Return the reward of the high level for metres of progress towards the goal."""
        return self.reward(progress_m) + REENTRY * min(self.reentries, MAX_REENTRIES)
