"""How large the replay buffer and the batch are, following the returns (Eqs. 21 to 23 with Table 2's rates)."""

import math
from collections import deque
from typing import Any

from zsdist.config import ReplayConfig


def cumulative_average_reward(reward_sum: float, actions: int) -> float:
    """R_avg, the mean paper reward of all actions so far: Eq. (21).

    Args:
        reward_sum: sum of the rewards of all actions, those for the goal and for collisions included.
        actions: how many actions that were, at least 1.
    """
    return reward_sum / actions


def buffer_size(size_min: int, size_max: int, average: float, target: float) -> int:
    """Transitions the buffer should hold, B_size: Eq. (22).

    Deviation: the ratio is that of `progress`, which is never below 0 and also right for a negative target.
    """
    return round(size_min + (size_max - size_min) * progress(average, target))


def batch_size(batch_min: int, batch_max: int, average: float, target: float) -> int:
    """Transitions a batch should have, b_size: Eq. (23).

    Deviation: the ratio is that of `progress`, which is never below 0 and also right for a negative target.
    """
    return round(batch_min + (batch_max - batch_min) * progress(average, target))


def progress(average: float, target: float) -> float:
    """How near `average` has come to `target`, in [0, 1]: never falls as the average rises, 1 from the target on.

    For a positive target it is average / target, clipped. For a negative one that quotient would grow as the average
    gets worse, so it is target / average there.
    """
    if average >= target:
        return 1.0
    if target > 0:
        return max(average / target, 0.0)
    return target / average


class RewardAverages:
    """Both averages of the paper's reward: over all actions, and over the last episodes (Fig. 9).

    Args:
        average_episodes: how many of the last episodes the mean return is over.
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
        """Takes in one finished episode.

        Args:
            paper_return: sum over the episode of the paper's reward (target distance, obstacles, goal).
            actions: how many actions it had.

        Raises:
            ValueError: the return is not finite or the count negative.
        """
        if not math.isfinite(paper_return) or actions < 0:
            raise ValueError(f"episode has return {paper_return} and {actions} actions; allowed are finite and >= 0")
        self._reward_sum += paper_return
        self._actions += actions
        self._returns.append(paper_return)

    def state(self) -> dict[str, Any]:
        """All of it as plain numbers, for `restore`."""
        return {"reward_sum": self._reward_sum, "actions": self._actions, "returns": list(self._returns)}

    def restore(self, state: dict[str, Any]) -> None:
        """Takes over a `state()`."""
        self._reward_sum, self._actions = float(state["reward_sum"]), int(state["actions"])
        self._returns = deque(state["returns"], maxlen=self._returns.maxlen)


class AdaptiveSizing:
    """Moves both sizes towards what the mean return calls for, by at most Table 2's rates.

    Every `adjust_every_episodes` finished episodes a size that is more than `grow_threshold` times too small grows to
    at most size / `grow_rate`, and one that is too large (wanted / size below `shrink_threshold`) shrinks to at least
    size * `shrink_rate`.

    Deviation: what `buffer_size` and `batch_size` are given is the mean return of the last episodes, since the mean
    over all actions since the start hardly moves after a while.

    Attributes:
        size: transitions the buffer may hold now.
        batch_size: transitions a batch has now.
    """

    def __init__(self, config: ReplayConfig) -> None:
        self._config = config
        self.size = config.size_initial
        self.batch_size = config.batch_initial
        self._adjustments = 0  # made or, where there was nothing to go by, passed over

    def finished_episodes(self, finished: int, mean_return: float | None) -> bool:
        """Adjusts the sizes if another `adjust_every_episodes` have finished, and says whether one changed.

        Args:
            finished: finished episodes of the whole run; one not above an earlier one changes nothing.
            mean_return: mean paper return of the last of them; None: not known, the sizes stay.

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
        """All of it as plain numbers, for `restore`."""
        return {"size": self.size, "batch_size": self.batch_size, "adjustments": self._adjustments}

    def restore(self, state: dict[str, int]) -> None:
        """Takes over a `state()`, of other bounds too: sizes outside the present ones move to the nearest allowed."""
        config = self._config
        self.size = min(max(int(state["size"]), config.size_min), config.size_max)
        self.batch_size = min(max(int(state["batch_size"]), config.batch_min), config.batch_max)
        self._adjustments = int(state["adjustments"])

    def _towards(self, size: int, wanted: int) -> int:
        config = self._config
        if wanted / size > config.grow_threshold:
            return min(math.ceil(size / config.grow_rate), wanted)
        if wanted / size < config.shrink_threshold:
            return max(math.floor(size * config.shrink_rate), wanted)
        return size
