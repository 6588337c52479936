"""Sizes of replay buffer and batch, adapted to the returns (Eqs. 21 to 23, with the rates of Table 2)."""

import math
from collections import deque
from typing import Any

from zsdist.config import ReplayConfig


def cumulative_average_reward(reward_sum: float, actions: int) -> float:
    """Return R_avg, the mean paper reward of all actions so far: Eq. (21).

    Args:
        reward_sum: sum of the rewards of all actions, including those for goal and collisions.
        actions: number of actions, at least 1.
    """
    return reward_sum / actions


def buffer_size(size_min: int, size_max: int, average: float, target: float) -> int:
    """Return B_size, the number of transitions that the buffer should hold: Eq. (22).

    Deviation: the ratio is that of `progress`, which is never below 0 and also right for a negative target.
    """
    return round(size_min + (size_max - size_min) * progress(average, target))


def batch_size(batch_min: int, batch_max: int, average: float, target: float) -> int:
    """Return b_size, the number of transitions that a batch should have: Eq. (23).

    Deviation: the ratio is that of `progress`, which is never below 0 and also right for a negative target.
    """
    return round(batch_min + (batch_max - batch_min) * progress(average, target))


def progress(average: float, target: float) -> float:
    """Return the progress of `average` towards `target`, in [0, 1]: it grows with the average, up to 1 at the target.

    For a positive target it is average / target, clipped. For a negative target that quotient would grow as the average
    gets worse, so it is target / average.
    """
    if average >= target:
        return 1.0
    if target > 0:
        return max(average / target, 0.0)
    return target / average


class RewardAverages:
    """Averages of the paper's reward: over all actions, and over the last episodes (Fig. 9).

    Args:
        average_episodes: number of last episodes in the mean return.
    """

    def __init__(self, average_episodes: int) -> None:
        self._reward_sum = 0.0
        self._actions = 0
        self._returns: deque[float] = deque(maxlen=average_episodes)

    @property
    def mean_reward(self) -> float | None:
        """Mean paper reward of all actions so far; None before the first."""
        return cumulative_average_reward(self._reward_sum, self._actions) if self._actions else None

    @property
    def mean_return(self) -> float | None:
        """Mean paper return of the last episodes; None before the first."""
        return math.fsum(self._returns) / len(self._returns) if self._returns else None

    def add_episode(self, paper_return: float, actions: int) -> None:
        """Add one finished episode.

        Args:
            paper_return: sum of the paper's reward (target distance, obstacles, goal) over the episode.
            actions: number of actions of the episode.

        Raises:
            ValueError: the return is not finite, or the count is negative.
        """
        if not math.isfinite(paper_return) or actions < 0:
            raise ValueError(f"episode has return {paper_return} and {actions} actions; allowed are finite and >= 0")
        self._reward_sum += paper_return
        self._actions += actions
        self._returns.append(paper_return)

    def state(self) -> dict[str, Any]:
        """Return all counts as plain numbers, for `restore`."""
        return {"reward_sum": self._reward_sum, "actions": self._actions, "returns": list(self._returns)}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        self._reward_sum, self._actions = float(state["reward_sum"]), int(state["actions"])
        self._returns = deque(state["returns"], maxlen=self._returns.maxlen)


class AdaptiveSizing:
    """Move both sizes towards those that the mean return calls for, by at most the rates of Table 2.

    Both are adjusted once in `adjust_every_episodes` finished episodes. A size grows to at most size / `grow_rate` if
    wanted / size is above `grow_threshold`, and shrinks to at least size * `shrink_rate` if wanted / size is below
    `shrink_threshold`.

    Deviation: `buffer_size` and `batch_size` get the mean return of the last episodes, because the mean over all
    actions since the start hardly moves after a while.

    Attributes:
        size: number of transitions that the buffer may hold.
        batch_size: number of transitions of a batch.
    """

    def __init__(self, config: ReplayConfig) -> None:
        self._config = config
        self.size = config.size_initial
        self.batch_size = config.batch_initial
        self._adjustments = 0  # adjustments made, or skipped for lack of a mean return

    def adjust(self, finished: int, mean_return: float | None) -> bool:
        """Adjust the sizes if another `adjust_every_episodes` have finished; return whether a size changed.

        Args:
            finished: finished episodes of the whole run; a number not above an earlier one changes nothing.
            mean_return: mean paper return of the last ones; None: unknown, and the sizes stay.

        Raises:
            ValueError: the mean is not finite.
        """
        config, before = self._config, (self.size, self.batch_size)
        due = finished // config.adjust_every_episodes - self._adjustments
        self._adjustments = max(self._adjustments, finished // config.adjust_every_episodes)
        if not config.adaptive or mean_return is None:
            return False
        if not math.isfinite(mean_return):
            raise ValueError(f"mean return is {mean_return}; allowed is a finite number")
        size = buffer_size(config.size_min, config.size_max, mean_return, config.target_return)
        batch = batch_size(config.batch_min, config.batch_max, mean_return, config.target_return)
        for _ in range(due):
            self.size = self._towards(self.size, size)
            self.batch_size = self._towards(self.batch_size, batch)
        return (self.size, self.batch_size) != before

    def state(self) -> dict[str, int]:
        """Return all counts as plain numbers, for `restore`."""
        config = self._config
        return {
            "size": self.size,
            "batch_size": self.batch_size,
            "adjustments": self._adjustments,
            "size_initial": config.size_initial,
            "batch_initial": config.batch_initial,
        }

    def restore(self, state: dict[str, int], finished: int) -> None:
        """Restore what `state` returned, under settings that may have changed.

        A size whose initial value is another one now begins from that. Sizes outside the present bounds move to the
        nearest allowed ones. Adjustments go on from `finished` episodes, however often they are made now.
        """
        config = self._config
        size, batch = state["size"], state["batch_size"]
        if state.get("size_initial", config.size_initial) != config.size_initial:
            size = config.size_initial
        if state.get("batch_initial", config.batch_initial) != config.batch_initial:
            batch = config.batch_initial
        self.size = min(max(int(size), config.size_min), config.size_max)
        self.batch_size = min(max(int(batch), config.batch_min), config.batch_max)
        self._adjustments = finished // config.adjust_every_episodes

    def _towards(self, size: int, wanted: int) -> int:
        """Return `size` after one adjustment towards `wanted`."""
        config = self._config
        if wanted / size > config.grow_threshold:
            return min(math.ceil(size / config.grow_rate), wanted)
        if wanted / size < config.shrink_threshold:
            return max(math.floor(size * config.shrink_rate), wanted)
        return size
