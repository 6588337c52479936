"""Compiled kernels of the conversion to and from half floats (`zsdist.common.half_precision`)."""

import numpy as np

from zsdist.common.compiled import compiled

_ROUND = np.uint32(0xFFF)  # half the unit of the last bit that is kept, less one
_REBIAS = np.uint32(112 << 23)  # difference of the exponents' biases, in the bits of a float32
_LEAST_NORMAL = np.uint32(0x38800000)  # bits of 2**-14, the least normal half float
_TOO_LARGE = np.uint32(0x47800000)  # bits of 65536.0, from which on values are infinite
_NOT_A_NUMBER = np.uint32(0x7F800000)  # bits of an infinite float32; those of NaN are larger
_BIAS_FACTOR = np.float32(2.0**112)  # difference of the exponents' biases, as a factor


@compiled()
def round_to_half(values: np.ndarray, bits: np.ndarray, out: np.ndarray) -> None:
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
def shift_bits(halves: np.ndarray, out: np.ndarray) -> None:
    """Write the bits of half floats to their positions in a float32; only the exponent of infinity and NaN is right."""
    for index in range(len(halves)):
        half = np.uint32(halves[index])
        bits = (half & np.uint32(0x7FFF)) << np.uint32(13)
        bits |= _NOT_A_NUMBER if (half & np.uint32(0x7C00)) == np.uint32(0x7C00) else np.uint32(0)
        out[index] = bits | (half & np.uint32(0x8000)) << np.uint32(16)


@compiled()
def correct_exponent(floats: np.ndarray) -> None:
    """Scale by the difference of the exponents' biases, in place; subnormal half floats become normal."""
    for index in range(len(floats)):
        floats[index] *= _BIAS_FACTOR
