"""Conversion to and from half floats, in which states travel and are stored.

A half float has 11 significant bits and magnitudes up to 65504.
"""

import numpy as np

_INFINITE = 0x7C00 << 1  # bits of an infinite float16 without its sign, shifted left by one; those of NaN are larger


def to_half(column: np.ndarray) -> np.ndarray:
    """Return float32 as rounded float16, several times faster than numpy; too large values become infinite."""
    from zsdist.common import half_kernels  # here, so that only those who convert load numba

    column = np.ascontiguousarray(column)
    halves = np.empty(column.shape, np.float16)
    half_kernels.round_to_half(column.ravel(), column.view(np.uint32).ravel(), halves.view(np.uint16).ravel())
    return halves


def from_half(column: np.ndarray) -> np.ndarray:
    """Return float16 as float32, several times faster than numpy."""
    from zsdist.common import half_kernels

    column = np.ascontiguousarray(column)
    floats = np.empty(column.shape, np.float32)
    half_kernels.shift_bits(column.view(np.uint16).ravel(), floats.view(np.uint32).ravel())
    half_kernels.correct_exponent(floats.ravel())
    return floats


def all_finite(column: np.ndarray) -> bool:
    """Return whether no float16 is NaN or infinite. Bits are compared, since `numpy.isfinite` is slow for float16."""
    return not column.size or int((column.view(np.uint16) << 1).max()) < _INFINITE


def finite_rows(column: np.ndarray) -> np.ndarray:
    """Return `(n,)` bool, true for the rows of a float16 `(n, D)` that hold neither NaN nor infinity."""
    if all_finite(column):
        return np.ones(len(column), bool)
    finite: np.ndarray = (column.view(np.uint16) << 1) < _INFINITE
    return np.asarray(finite.all(axis=1))
