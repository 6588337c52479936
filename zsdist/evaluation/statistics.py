"""Confidence intervals: Wilson's for rates, the bootstrap for means."""

import math

import numpy as np

Z_95 = 1.959963984540054  # two-sided 95% point of the normal distribution
RESAMPLES = 2000


def wilson_95(successes: int, trials: int) -> tuple[float, float]:
    """Wilson's score interval of a rate: keeps inside [0, 1] and has a width even where every trial went one way.

    Args:
        successes: of `trials`.
        trials: at least 1.
    """
    if not 0 <= successes <= trials or trials < 1:
        raise ValueError(f"{successes} successes of {trials} trials; allowed are 0 to trials, of at least one")
    rate = successes / trials
    spread = Z_95**2 / trials
    centre = (rate + spread / 2) / (1 + spread)
    half = Z_95 * math.sqrt(rate * (1 - rate) / trials + spread / (4 * trials)) / (1 + spread)
    return (0.0 if successes == 0 else centre - half), (1.0 if successes == trials else centre + half)


def bootstrap_95(values: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    """Percentile bootstrap interval of a mean.

    Args:
        values: `(n,)`, at least one.
        rng: draws the resamples.
    """
    if len(values) == 0:
        raise ValueError("no values; a mean needs at least one")
    picks = rng.integers(len(values), size=(RESAMPLES, len(values)))
    low, high = np.quantile(np.asarray(values, dtype=float)[picks].mean(axis=1), (0.025, 0.975))
    return float(low), float(high)
