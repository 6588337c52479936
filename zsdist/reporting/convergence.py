"""Reward curves over training episodes, and the paper's three metrics of the singleton case (Sec. 4.4).

The paper names its metrics without formulas. They are computed here as follows:

* **Efficiency**: "the step costs compared to the shortest possible paths". The fewest possible actions divided by
  those taken, averaged over the successful greedy episodes; 1 is the best. Evaluations compute it, not this module.
* **Final convergence value**: mean of a reward curve over the last tenth of the episodes.
* **Convergence degree**: the number of episodes to convergence, and the fluctuation. A curve has converged at the
  episode from which it stays within a tenth of its whole range of the final value; if that episode is in the last
  tenth, it has not converged. Fluctuation is the root mean square of the episodes' returns about their running mean,
  in the first and in the last half.

There are two curves, because the paper has both: the mean return of the last episodes (its Fig. 9 over episodes) and
the mean reward of all actions so far (its equation 21).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zsdist.replay.sizing import cumulative_average_reward
from zsdist.reporting.runs import Run
from zsdist.types import Outcome

LAST_SHARE = 0.1  # share of the episodes over which the final value is averaged
BAND_SHARE = 0.1  # share of the curve's range within which it has converged
LEAST_EPISODES = 20  # with fewer, a tenth is too few to average


@dataclass(frozen=True)
class Convergence:
    """Final value and convergence of a reward curve.

    Attributes:
        final: final convergence value.
        episode: number of the episode at which it converged, from 1; None: it has not converged.
    """

    final: float
    episode: int | None


def running_mean(values: np.ndarray, window: int) -> np.ndarray:
    """Return the mean of each value and up to `window - 1` values before it, `(n,)`."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - window, 0)
    return (sums[ends] - sums[starts]) / (ends - starts)


def returns(run: Run) -> np.ndarray:
    """Return the sum of the paper's reward over each episode, `(n,)`, in the order in which they finished."""
    return np.array([episode["return"] for episode in run.episodes], dtype=float)


def per_episode(run: Run) -> np.ndarray:
    """Return the mean return of the last `replay.average_episodes` episodes, `(n,)`."""
    return running_mean(returns(run), run.settings.replay.average_episodes)


def per_action(run: Run) -> np.ndarray:
    """Return the mean reward of all actions up to the end of each episode, `(n,)`."""
    actions = np.maximum(np.cumsum([episode["steps"] for episode in run.episodes]), 1)
    totals = np.cumsum(returns(run))
    return np.array([cumulative_average_reward(*pair) for pair in zip(totals.tolist(), actions.tolist(), strict=True)])


def share(run: Run, outcome: Outcome, window: int) -> np.ndarray:
    """Return the share of the last `window` training episodes with an outcome, `(n,)`."""
    return running_mean(np.array([episode["outcome"] == outcome for episode in run.episodes], dtype=float), window)


def converged(curve: np.ndarray) -> Convergence | None:
    """Return final value and convergence of a curve `(n,)`; None where it is too short."""
    if len(curve) < LEAST_EPISODES:
        return None
    last = int(np.ceil(len(curve) * LAST_SHARE))
    final = float(curve[-last:].mean())
    outside = np.flatnonzero(np.abs(curve - final) > BAND_SHARE * np.ptp(curve))
    first = int(outside[-1]) + 1 if len(outside) else 0
    return Convergence(final, first + 1 if first < len(curve) - last else None)


def fluctuation(run: Run) -> tuple[float, float] | None:
    """Return the root mean square of returns about their running mean, in the first and in the last half of a run."""
    values = returns(run)
    if len(values) < LEAST_EPISODES:
        return None
    squares, middle = (values - per_episode(run)) ** 2, len(values) // 2
    return float(np.sqrt(squares[:middle].mean())), float(np.sqrt(squares[middle:].mean()))


def band(curves: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mean, minimum and maximum of curves over the episodes that all of them have, `(n,)` each."""
    length = min(len(curve) for curve in curves)
    stacked = np.stack([curve[:length] for curve in curves])
    return stacked.mean(0), stacked.min(0), stacked.max(0)
