"""Half floats, as which states travel and are held: 11 significant bits, magnitudes up to 65504."""

import numpy as np

from zsdist.common.compiled import compiled

_INFINITE = 0x7C00 << 1  # bits of infinity; of NaN they are more
_ROUND, _REBIAS = np.uint32(0xFFF), np.uint32(112 << 23)  # what is cut off, but for its last bit; between the exponents
_LEAST_NORMAL, _TOO_LARGE, _NOT_A_NUMBER = (
    np.uint32(0x38800000),
    np.uint32(0x47800000),
    np.uint32(0x7F800000),
)  # above it
_WIDER = np.float32(2.0**112)  # the same difference of exponents, as a factor


def to_half(column: np.ndarray) -> np.ndarray:
    """float32 as float16, rounded; what is too large becomes infinite. numpy takes several times as long."""
    column = np.ascontiguousarray(column)
    halves = np.empty(column.shape, np.float16)
    _narrow(column.ravel(), column.view(np.uint32).ravel(), halves.view(np.uint16).ravel())
    return halves


def from_half(column: np.ndarray) -> np.ndarray:
    """float16 as float32. numpy takes several times as long."""
    column = np.ascontiguousarray(column)
    floats = np.empty(column.shape, np.float32)
    _place(column.view(np.uint16).ravel(), floats.view(np.uint32).ravel())
    _rescale(floats.ravel())
    return floats


def all_finite(column: np.ndarray) -> bool:
    """Whether no float16 is NaN or infinite: by its bits, sign shifted out, for numpy has nothing fast for it."""
    return not column.size or int((column.view(np.uint16) << 1).max()) < _INFINITE


def finite_rows(column: np.ndarray) -> np.ndarray:
    """Which rows of float16 hold no NaN and no infinity, `(n,)` bool for `(n, D)`."""
    if all_finite(column):
        return np.ones(len(column), bool)
    return ((column.view(np.uint16) << 1) < _INFINITE).all(axis=1)


@compiled()
def _narrow(values: np.ndarray, bits: np.ndarray, out: np.ndarray) -> None:
    """Half floats of `values`, whose bits are given beside them, to the nearest; of two as near to the even one."""
    for index in range(len(bits)):
        word = bits[index] & np.uint32(0x7FFFFFFF)
        normal = (word - _REBIAS + _ROUND + ((word >> np.uint32(13)) & np.uint32(1))) >> np.uint32(13)
        small = np.uint32(np.rint(abs(values[index]) * np.float32(2.0**24))) if word < _LEAST_NORMAL else np.uint32(0)
        large = np.uint32(0x7E00) if word > _NOT_A_NUMBER else np.uint32(0x7C00)
        half = small if word < _LEAST_NORMAL else (large if word >= _TOO_LARGE else normal)
        out[index] = half | ((bits[index] >> np.uint32(16)) & np.uint32(0x8000))


@compiled()
def _place(halves: np.ndarray, out: np.ndarray) -> None:
    """Bits of half floats where a float32 has them; the exponent stays a half float's, unless all its bits are set."""
    for index in range(len(halves)):
        half = np.uint32(halves[index])
        bits = (half & np.uint32(0x7FFF)) << np.uint32(13)
        bits |= _NOT_A_NUMBER if (half & np.uint32(0x7C00)) == np.uint32(0x7C00) else np.uint32(0)
        out[index] = bits | (half & np.uint32(0x8000)) << np.uint32(16)


@compiled()
def _rescale(floats: np.ndarray) -> None:
    """From a half float's exponent to a float32's; subnormal ones become normal."""
    for index in range(len(floats)):
        floats[index] *= _WIDER
