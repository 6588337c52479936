"""Checks for NaN and infinity where numbers come from outside: a simulation, a network, a message."""

import math

import numpy as np

from zsdist.errors import RunError


def all_finite(array: np.ndarray) -> bool:
    """Return whether a float array holds neither NaN nor infinity; a sum tells it in less time than `isfinite`."""
    with np.errstate(all="ignore"):
        return math.isfinite(float(array.sum())) or bool(np.isfinite(array).all())


def require(what: str, numbers: np.ndarray) -> None:
    """Raise `RunError` where one of the numbers is not finite.

    Args:
        what: what they are, for people.
        numbers: floats.
    """
    if not all_finite(numbers):
        wrong = numbers[~np.isfinite(numbers)]
        raise RunError(f"{what} hold {wrong[0]}, {wrong.size} of {numbers.size} numbers; allowed are finite ones")
