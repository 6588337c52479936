"""Reward curves over training episodes, and the paper's three metrics of the singleton case (Sec. 4.4) read off them.

The paper names its metrics without formulas. What is computed here:

* **Efficiency**: "the step costs compared to the shortest possible paths". Fewest possible actions over those taken,
  mean over the greedy episodes that arrived; 1 is the best. It comes from evaluations, not from here.
* **Final convergence value**: mean of a reward curve over the last tenth of the episodes.
* **Convergence degree**: the episodes it took to converge, and the fluctuation. Converged is a curve from where it
  stays within a tenth of its whole range about the final value; where that is only in the last tenth, it has not.
  Fluctuation is the root mean square of the episodes' returns about their running mean, in the first and the last half.

There are two curves, as the paper has both: the mean return of the last episodes (what its Fig. 9 shows over episodes)
and the mean reward of all actions so far, its equation 21.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zsdist.replay.sizing import cumulative_average_reward
from zsdist.reporting.runs import Run
from zsdist.types import Outcome

LAST_SHARE = 0.1  # of the episodes, over which the final value is taken
BAND_SHARE = 0.1  # of the curve's range, within which it has converged
LEAST_EPISODES = 20  # fewer have no tenth worth the name


@dataclass(frozen=True)
class Convergence:
    """How a reward curve ended.

    Attributes:
        final: value.
        episode: from which it had converged, counted from 1; None: it has not.
    """

    final: float
    episode: int | None


def running_mean(values: np.ndarray, window: int) -> np.ndarray:
    """Mean of each value and up to `window - 1` before it, `(n,)`."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - window, 0)
    return (sums[ends] - sums[starts]) / (ends - starts)


def returns(run: Run) -> np.ndarray:
    """The paper's reward summed over each episode, `(n,)`, in the order in which they finished."""
    return np.array([episode["return"] for episode in run.episodes], dtype=float)


def per_episode(run: Run) -> np.ndarray:
    """Mean return of the last `replay.average_episodes` episodes, `(n,)`."""
    return running_mean(returns(run), run.settings.replay.average_episodes)


def per_action(run: Run) -> np.ndarray:
    """Mean reward of all actions up to the end of each episode, `(n,)`."""
    actions = np.cumsum([episode["steps"] for episode in run.episodes])
    return cumulative_average_reward(np.cumsum(returns(run)), np.maximum(actions, 1))


def share(run: Run, outcome: Outcome, window: int) -> np.ndarray:
    """Share of the last `window` training episodes that ended so, `(n,)`."""
    return running_mean(np.array([episode["outcome"] == outcome for episode in run.episodes], dtype=float), window)


def converged(curve: np.ndarray) -> Convergence | None:
    """Final value and convergence of a curve `(n,)`; None where it is too short to tell."""
    if len(curve) < LEAST_EPISODES:
        return None
    last = int(np.ceil(len(curve) * LAST_SHARE))
    final = float(curve[-last:].mean())
    outside = np.flatnonzero(np.abs(curve - final) > BAND_SHARE * np.ptp(curve))
    first = int(outside[-1]) + 1 if len(outside) else 0
    return Convergence(final, first + 1 if first < len(curve) - last else None)


def fluctuation(run: Run) -> tuple[float, float] | None:
    """Root mean square of returns about their running mean, in the first and in the last half of a run."""
    values = returns(run)
    if len(values) < LEAST_EPISODES:
        return None
    squares, middle = (values - per_episode(run)) ** 2, len(values) // 2
    return float(np.sqrt(squares[:middle].mean())), float(np.sqrt(squares[middle:].mean()))


def band(curves: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, least and greatest of curves over the episodes that all of them have, `(n,)` each."""
    length = min(len(curve) for curve in curves)
    stacked = np.stack([curve[:length] for curve in curves])
    return stacked.mean(0), stacked.min(0), stacked.max(0)
