"""Confidence intervals: Wilson's for rates, the bootstrap for means and for several runs of one method."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import trim_mean

Z_95 = 1.959963984540054  # two-sided 95% point of the normal distribution
RESAMPLES = 2000


def wilson_95(successes: int, trials: int) -> tuple[float, float]:
    """Return Wilson's score interval of a rate, which stays in [0, 1] and has a width even if all trials are alike.

    Args:
        successes: number of successes, at most `trials`.
        trials: number of trials, at least 1.
    """
    if not 0 <= successes <= trials or trials < 1:
        raise ValueError(
            f"{successes} successes of {trials} trials; allowed are 1 trial or more, and 0 to {trials} successes"
        )
    rate = successes / trials
    spread = Z_95**2 / trials
    centre = (rate + spread / 2) / (1 + spread)
    half = Z_95 * math.sqrt(rate * (1 - rate) / trials + spread / (4 * trials)) / (1 + spread)
    return (0.0 if successes == 0 else centre - half), (1.0 if successes == trials else centre + half)


def bootstrap_95(values: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    """Return the percentile bootstrap interval of a mean.

    Args:
        values: `(n,)` values, at least one.
        rng: draws the resamples.
    """
    if len(values) == 0:
        raise ValueError("there are no values; a mean needs at least one")
    picks = rng.integers(len(values), size=(RESAMPLES, len(values)))
    low, high = np.quantile(np.asarray(values, dtype=float)[picks].mean(axis=1), (0.025, 0.975))
    return float(low), float(high)


def interquartile_mean(values: np.ndarray) -> np.ndarray:
    """Return the mean of the middle half along the last axis: a quarter, rounded down, is left out at either end.

    For fewer than four values it is their mean.
    """
    return trim_mean(values, 0.25, axis=-1)


def runs_95(scores: np.ndarray, strata: Sequence[str], rng: np.random.Generator) -> tuple[float, float, float]:
    """Return the interquartile mean over runs of their mean score, and its stratified bootstrap interval.

    A resample draws runs and, within each stratum, episodes. The episodes are the same for all runs, since these drove
    the same scenes. Each resample gives the means of its runs, and their interquartile mean.

    Args:
        scores: `(runs, episodes)` scores, at least one of each.
        strata: `(episodes,)` names of groups that are resampled separately, such as families of scenes.
        rng: draws the resamples.

    Returns:
        The interquartile mean, and the ends of its interval.
    """
    if scores.size == 0:
        raise ValueError("there are no scores; an interquartile mean needs at least one")
    runs, names = len(scores), np.asarray(strata)
    groups = [np.flatnonzero(names == name) for name in dict.fromkeys(strata)]
    means = np.empty((RESAMPLES, runs))
    for row in means:
        episodes = np.concatenate([rng.choice(group, len(group)) for group in groups])
        row[:] = scores[rng.integers(runs, size=runs)][:, episodes].mean(axis=1)
    low, high = np.quantile(interquartile_mean(means), (0.025, 0.975))
    return float(interquartile_mean(scores.mean(axis=1))), float(low), float(high)
