"""What the levels learn from: shaped rewards, and trajectories assembled step by step."""

import math
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from zsdist.planning.grid import Grid
from zsdist.planning.shortest_path import metres_cost
from zsdist.types import NO_GUIDE, Action, Behaviour, Level, Trajectory

# Rewards of a low-level step, in units in which the way through a block is worth about two.
PROGRESS_A_METRE = 0.5
STEP = -0.05
REVISIT = -0.1  # for each earlier visit of the state reached, up to MAX_REVISITS
MAX_REVISITS = 8
REENTRY = -0.3  # for each earlier visit of the block come into, up to MAX_REENTRIES; the high level only
MAX_REENTRIES = 4
SQUEEZED = -0.2  # where the shield had to give way: not forbidden, but better not come there
ENTRY = 0.5
GOAL = 2.0
COLLISION = -4.0
TURN_45_M, TURN_90_M = 0.1, 0.4  # what turns add to the length of a way, so that turning towards it is progress too
MAX_PROGRESS_M = 2.0  # a change of the map may move the way's length by more; that is no merit of the action


@cache
def way_costs(grid: Grid) -> np.ndarray:
    """Cost of each action by heading `(8, 5)`, metres with something for turns: the measure of progress. Read-only."""
    costs = metres_cost(grid)
    costs[:, [Action.LEFT_45, Action.RIGHT_45]] += TURN_45_M
    costs[:, [Action.TURN_LEFT_90, Action.TURN_RIGHT_90]] += TURN_90_M
    costs.flags.writeable = False
    return costs


def progress_m(cost: np.ndarray, before: tuple[int, int, int], after: tuple[int, int, int]) -> float:
    """Metres by which the believed way to a target became shorter; 0 where there is none.

    Args:
        cost: `(cells, cells, 8)` metres to the target, on the map after the step.
        before: `(iy, ix, heading)` before the step.
        after: the same after it.
    """
    gained = float(cost[before]) - float(cost[after])
    return min(max(gained, -MAX_PROGRESS_M), MAX_PROGRESS_M) if math.isfinite(gained) else 0.0


@dataclass(frozen=True)
class Step:
    """What happened in one low-level step, apart from progress.

    Attributes:
        revisits: earlier visits of the state reached.
        reentries: earlier visits of the block come into; 0 where the block is the same as before.
        squeezed: the shield had to give way there.
        reached: the goal was reached.
        collided: something was hit.
    """

    revisits: int
    reentries: int
    squeezed: bool
    reached: bool
    collided: bool

    def reward(self, progress_m: float) -> float:
        """Progress along the believed way, less for dawdling, going in circles and squeezing; more for arriving."""
        reward = PROGRESS_A_METRE * progress_m + STEP + REVISIT * min(self.revisits, MAX_REVISITS)
        return reward + SQUEEZED * self.squeezed + GOAL * self.reached + COLLISION * self.collided

    def low_reward(self, progress_m: float, entered: bool) -> float:
        """Of the low level, `progress_m` towards its subgoal; `entered`: the block it was sent to was come into."""
        return self.reward(progress_m) + ENTRY * entered

    def high_reward(self, progress_m: float) -> float:
        """Of the high level, `progress_m` towards the goal."""
        return self.reward(progress_m) + REENTRY * min(self.reentries, MAX_REENTRIES)


@dataclass
class TrajectoryBuilder:
    """Transitions of one question (a subgoal, an option) while they happen.

    Attributes:
        level: which DQN it is for.
        discount: gamma.
        weight_version: version of the weights when the episode began; newer ones act as soon as they come.
    """

    level: Level
    discount: float
    weight_version: int
    _states: list[np.ndarray] = field(default_factory=list)
    _masks: list[np.ndarray] = field(default_factory=list)
    _actions: list[int] = field(default_factory=list)
    _guides: list[int] = field(default_factory=list)
    _behaviours: list[Behaviour] = field(default_factory=list)
    _rewards: list[float] = field(default_factory=list)

    def act(self, state: np.ndarray, mask: np.ndarray, action: int, guide: int | None, behaviour: Behaviour) -> None:
        """A step begins."""
        self._states.append(state)
        self._masks.append(mask)
        self._actions.append(action)
        self._guides.append(NO_GUIDE if guide is None else int(guide))
        self._behaviours.append(behaviour)

    def reward(self, reward: float) -> None:
        """The step has ended."""
        self._rewards.append(reward)

    def close(self, state: np.ndarray, mask: np.ndarray, final: bool) -> Trajectory | None:
        """The trajectory up to `state`; `final`: nothing follows, so nothing is bootstrapped. None without steps."""
        count = len(self._rewards)
        if not count:
            return None
        rewards = np.array(self._rewards, np.float32)
        discounts = np.full(count, self.discount, np.float32)
        successors = np.arange(1, count + 1)
        if self.level is Level.HIGH:
            rewards, discounts = _to_the_end(rewards, self.discount)
            successors = np.full(count, count)
            if final:
                discounts[:] = 0.0
        elif final:
            discounts[-1] = 0.0
        return Trajectory(
            level=self.level,
            states=np.stack([*self._states[:count], state]),
            actions=np.array(self._actions[:count], np.uint8),
            rewards=rewards,
            discounts=discounts,
            successors=successors.astype(np.uint16),
            masks=np.stack([*self._masks[:count], mask]),
            guides=np.array(self._guides[:count], np.int8),
            behaviours=np.array(self._behaviours[:count], np.uint8),
            weight_version=self.weight_version,
        )


def _to_the_end(rewards: np.ndarray, discount: float) -> tuple[np.ndarray, np.ndarray]:
    """Discounted sums `sum gamma^t r` from each step to the last, and `gamma^k` over the `k` steps left."""
    sums, factors = np.empty_like(rewards), np.empty_like(rewards)
    total, factor = 0.0, 1.0
    for index in range(len(rewards) - 1, -1, -1):
        total, factor = float(rewards[index]) + discount * total, factor * discount
        sums[index], factors[index] = total, factor
    return sums, factors
