"""Conversion to and from half floats, in which states travel and are stored.

A half float has 11 significant bits and magnitudes up to 65504.
"""

import numpy as np

from zsdist.common.compiled import compiled

_INFINITE = 0x7C00 << 1  # bits of an infinite float16 without its sign, shifted left by one; those of NaN are larger
_ROUND = np.uint32(0xFFF)  # half the unit of the last bit that is kept, less one
_REBIAS = np.uint32(112 << 23)  # difference of the exponents' biases, in the bits of a float32
_LEAST_NORMAL = np.uint32(0x38800000)  # bits of 2**-14, the least normal half float
_TOO_LARGE = np.uint32(0x47800000)  # bits of 65536.0, from which on values are infinite
_NOT_A_NUMBER = np.uint32(0x7F800000)  # bits of an infinite float32; those of NaN are larger
_BIAS_FACTOR = np.float32(2.0**112)  # difference of the exponents' biases, as a factor


def to_half(column: np.ndarray) -> np.ndarray:
    """Return float32 as rounded float16, several times faster than numpy; too large values become infinite."""
    column = np.ascontiguousarray(column)
    halves = np.empty(column.shape, np.float16)
    _round_to_half(column.ravel(), column.view(np.uint32).ravel(), halves.view(np.uint16).ravel())
    return halves


def from_half(column: np.ndarray) -> np.ndarray:
    """Return float16 as float32, several times faster than numpy."""
    column = np.ascontiguousarray(column)
    floats = np.empty(column.shape, np.float32)
    _shift_bits(column.view(np.uint16).ravel(), floats.view(np.uint32).ravel())
    _correct_exponent(floats.ravel())
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


@compiled()
def _round_to_half(values: np.ndarray, bits: np.ndarray, out: np.ndarray) -> None:
    """Write the bits of the nearest half floats into `out`; ties go to the even one.

    Args:
        values: `(n,)` float32.
        bits: the same memory as uint32.
        out: `(n,)` uint16.
    """
    for index in range(len(bits)):
        word = bits[index] & np.uint32(0x7FFFFFFF)
        normal = (word - _REBIAS + _ROUND + ((word >> np.uint32(13)) & np.uint32(1))) >> np.uint32(13)
        small = np.uint32(np.rint(abs(values[index]) * np.float32(2.0**24))) if word < _LEAST_NORMAL else np.uint32(0)
        large = np.uint32(0x7E00) if word > _NOT_A_NUMBER else np.uint32(0x7C00)
        half = small if word < _LEAST_NORMAL else (large if word >= _TOO_LARGE else normal)
        out[index] = half | ((bits[index] >> np.uint32(16)) & np.uint32(0x8000))


@compiled()
def _shift_bits(halves: np.ndarray, out: np.ndarray) -> None:
    """Write the bits of half floats to their positions in a float32; only the exponent of infinity and NaN is right."""
    for index in range(len(halves)):
        half = np.uint32(halves[index])
        bits = (half & np.uint32(0x7FFF)) << np.uint32(13)
        bits |= _NOT_A_NUMBER if (half & np.uint32(0x7C00)) == np.uint32(0x7C00) else np.uint32(0)
        out[index] = bits | (half & np.uint32(0x8000)) << np.uint32(16)


@compiled()
def _correct_exponent(floats: np.ndarray) -> None:
    """Scale by the difference of the exponents' biases, in place; subnormal half floats become normal."""
    for index in range(len(floats)):
        floats[index] *= _BIAS_FACTOR
