"""Soundness of an update: whether all of its numbers are finite and none leaves its range, and where one first does."""

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.dqn import network
from zsdist.types import Parameters


class UnsoundUpdateError(ArithmeticError):
    """Gradient step that was not made, since one of its numbers is not finite or out of range.

    Attributes:
        largest: the largest magnitude among its values and errors, or the norm of its gradient; NaN if one is.
    """

    def __init__(self, largest: float) -> None:
        super().__init__(f"an update computed {largest:.6g}")
        self.largest = largest


class Quantity(NamedTuple):
    """Numbers that an update reads or computes.

    Attributes:
        name: what they are, for people.
        numbers: array of any shape.
        limit: magnitude that they may have.
    """

    name: str
    numbers: np.ndarray
    limit: float = math.inf


def require(limit: float, gradient_norm: float, *arrays: np.ndarray) -> None:
    """Raise `UnsoundUpdateError` unless the norm and all arrays are finite, and the arrays within `limit`."""
    for array in arrays:
        largest = largest_magnitude(array.ravel())
        if not math.isfinite(largest) or largest > limit:
            raise UnsoundUpdateError(largest)
    if not math.isfinite(gradient_norm):
        raise UnsoundUpdateError(gradient_norm)


@compiled()
def largest_magnitude(numbers: np.ndarray) -> float:
    """Return the largest magnitude in `(n,)` numbers, 0 if there are none; NaN if one is."""
    largest = 0.0
    for number in numbers:
        if np.isnan(number):
            return np.nan
        largest = max(largest, abs(number))
    return largest


def first_unsound(quantities: Iterable[Quantity]) -> str | None:
    """Return which quantity is the first to hold a number that is not finite or beyond its limit, and where in it."""
    for name, numbers, limit in quantities:
        with np.errstate(invalid="ignore"):
            wrong = np.argwhere(~(np.abs(numbers) <= min(limit, np.finfo(np.float32).max)))
        if len(wrong):
            place = tuple(int(index) for index in wrong[0])
            where = f" at {list(place)}" if place else ""
            return f"{name}: {float(numbers[place]):.6g}{where}, {len(wrong)} of {numbers.size} numbers"
    return None


def layers(of: str, parameters: Parameters, states: np.ndarray, limit: float) -> Iterator[Quantity]:
    """Return the outputs of each layer of a network, in order.

    Args:
        of: name of the network, for people.
        parameters: its parameters.
        states: `(B, D)` float32.
        limit: magnitude that the values of actions may have.
    """
    x = states
    for i in range(network.depth(parameters)):
        x = x @ parameters[f"hidden{i}.weight"].T + parameters[f"hidden{i}.bias"]
        yield Quantity(f"hidden layer {i} of the {of} network", x)
        x = x - x.mean(axis=1, keepdims=True)
        x = x / np.sqrt((x * x).mean(axis=1, keepdims=True) + np.float32(network.NORM_EPSILON))
        x = x * parameters[f"hidden{i}.norm_scale"] + parameters[f"hidden{i}.norm_shift"]
        yield Quantity(f"normalised layer {i} of the {of} network", x)
        x = np.maximum(x, 0)
    yield Quantity(f"values of the {of} network", x @ parameters["output.weight"].T + parameters["output.bias"], limit)
