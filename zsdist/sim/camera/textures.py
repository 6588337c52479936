"""Numba kernels of textures: noise from a pyramid of halvings, and figures on grounds and surfaces."""

from functools import lru_cache

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.sim.camera.appearance import Pattern, Texture
from zsdist.sim.camera.kernels import ROWWISE

_TILES, _STRIPES, _CHECKER = int(Pattern.TILES), int(Pattern.STRIPES), int(Pattern.CHECKER)
_BRICK, _WINDOWS = int(Texture.BRICK), int(Texture.WINDOWS)

# single precision, which a plain number in a kernel would not be
_ZERO, _ONE, _TWO, _HALF = (np.float32(value) for value in (0.0, 1.0, 2.0, 0.5))
_PER_UNIT = np.float32(1 / 127)
_JOINT, _DASH = np.float32(0.05), np.float32(0.6)  # of tiles, and of a lane's line, as shares of a period
_COURSES, _BRICKS, _MORTAR, _GAP = (np.float32(value) for value in (1 / 0.2, 1 / 0.45, 0.12, 0.06))
_STOREYS = np.float32(1 / 1.1)
_GUTTER, _PAVED, _JOINED = (np.float32(value) for value in (-0.25, 0.75, 0.45))  # shares of the pavement's colour
_GUTTER_M, _KERB_M, _LINE = (np.float32(value) for value in (0.25, 0.15, 0.06))  # widths; of a line, half
_DASHES, _SLAB_JOINT = np.float32(1 / 3.0), np.float32(0.04)  # of the middle line, a metre; share of a slab
_PANE_LEFT, _PANE_RIGHT, _SILL, _LINTEL = (np.float32(value) for value in (0.25, 0.75, 0.35, 0.85))

_NOISE_SIZE = 512
_NOISE_LEVELS = 8
_RUN = 32  # pixels
_SPECTRA = (((1.6, 1.0),), ((0.8, 1.0), (0.25, 0.6)))  # of clouds and of grain: exponents of 1 / frequency, shares
CLOUDS, GRAIN = range(2)


@lru_cache(maxsize=1)
def noise_pyramid() -> np.ndarray:
    """Tiling noise of each spectrum and its halvings, `(2, sum of sizes)` int8, always the same.

    Kept small (int8, 127 is 1) so that all of it stays in the processor's cache.
    """
    rng = np.random.default_rng(20240229)
    frequency = np.fft.fftfreq(_NOISE_SIZE)
    radius = np.hypot(frequency[:, None], frequency[None, :])
    radius[0, 0] = np.inf
    rows = []
    for spectrum in _SPECTRA:
        level = np.zeros(radius.shape)
        for exponent, share in spectrum:
            white = np.fft.fft2(rng.standard_normal(radius.shape))
            part = np.fft.ifft2(white * radius**-exponent).real
            level += share * part / part.std()
        level = np.clip(level / 2.5, -1, 1)
        levels = [level]
        while len(levels) < _NOISE_LEVELS:
            level = level.reshape(level.shape[0] // 2, 2, -1, 2).mean((1, 3))
            levels.append(level)
        rows.append(np.concatenate([level.ravel() for level in levels]))
    return np.rint(127 * np.array(rows)).astype(np.int8)


@compiled(**ROWWISE)
def noise(
    pyramid: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    per_m: float,
    footprint: np.ndarray,
    at: np.ndarray,
    out: np.ndarray,
) -> None:
    """Noise at places in metres, of `per_m` texels a metre, from the halving whose texel is about the pixel's size.

    A run of `_RUN` pixels uses one halving, the one that fits its middle. Runs that use the same are read in one go.
    `at` is room to work in, uint32 and as long as the others.
    """
    n = len(out)
    first, halvings = 0, _halvings(footprint[min(_RUN, n) // 2] * per_m) if n else 0
    for next_run in range(_RUN, n, _RUN):
        its = _halvings(footprint[(next_run + min(next_run + _RUN, n)) // 2] * per_m)
        if its != halvings:
            _texels(pyramid, halvings, per_m, u[first:next_run], v[first:next_run], at, out[first:next_run])
            first, halvings = next_run, its
    _texels(pyramid, halvings, per_m, u[first:], v[first:], at, out[first:])


@compiled(**ROWWISE)
def _halvings(texels: float) -> int:
    """How often the noise is to be halved so that one pixel spans one texel or less, where it spans `texels` now."""
    halvings = 0
    for k in range(_NOISE_LEVELS - 1):
        halvings += texels > 1 << k
    return halvings


@compiled(**ROWWISE)
def _texels(
    pyramid: np.ndarray, halvings: int, per_m: float, u: np.ndarray, v: np.ndarray, at: np.ndarray, out: np.ndarray
) -> None:
    start, size = 0, _NOISE_SIZE
    for _ in range(halvings):
        start += size * size
        size >>= 1
    level = pyramid[start : start + size * size]
    texels, mask, stride = np.float32(per_m * size / _NOISE_SIZE), np.int32(size - 1), np.int32(size)
    # Loops of their own: what reads from memory here and there would keep the compiler from doing many pixels at once.
    for j in range(len(out)):
        row = np.int32(np.floor(v[j] * texels)) & mask
        column = np.int32(np.floor(u[j] * texels)) & mask
        at[j] = np.uint32(row * stride + column)
    for j in range(len(out)):
        out[j] = np.float32(level[at[j]]) * _PER_UNIT


@compiled(**ROWWISE)
def ground_figure(pattern: int, x: np.ndarray, y: np.ndarray, period: float, out: np.ndarray) -> None:
    """Whether places on the ground bear the pattern's second colour, 0 to 1."""
    per_m, dash = np.float32(1.0 / period), np.float32(0.12 / period)
    for j in range(len(out)):
        u, v = x[j] * per_m, y[j] * per_m
        u, v = u - np.floor(u), v - np.floor(v)
        if pattern == _TILES:
            borne = (u < _JOINT) | (v < _JOINT)
        elif pattern == _STRIPES:
            borne = u < _HALF
        elif pattern == _CHECKER:
            borne = (u < _HALF) == (v < _HALF)
        else:
            borne = (u < dash) & (v < _DASH)
        out[j] = _ONE if borne else _ZERO


@compiled(**ROWWISE)
def road_figure(
    along: np.ndarray, left: np.ndarray, road: np.ndarray, slab_m: float, footprint: np.ndarray, out: np.ndarray
) -> None:
    """How far places have the colour of kerbs and pavements, below 0 for a gutter; lines finer than a pixel are out.

    Args:
        along: `(n,)` in metres.
        left: `(n,)` of the origin, in metres.
        road: `(2,)` how far left of the origin the road's middle is, and half its width, in metres.
        slab_m: side of the pavement's slabs.
        footprint: `(n,)` of a pixel, in metres.
        out: `(n,)`, written.
    """
    middle, half = np.float32(road[0]), np.float32(road[1])
    per_slab, finest = np.float32(1.0 / slab_m), np.float32(0.05 * slab_m)
    for j in range(len(out)):
        aside = abs(left[j] - middle)
        beyond = aside - half
        dash, u, v = along[j] * _DASHES, along[j] * per_slab, beyond * per_slab
        line = (footprint[j] < _LINE) & (aside < _LINE) & (dash - np.floor(dash) < _HALF)
        joint = (footprint[j] < finest) & ((u - np.floor(u) < _SLAB_JOINT) | (v - np.floor(v) < _SLAB_JOINT))
        road_share = _GUTTER if beyond > -_GUTTER_M else (_ONE if line else _ZERO)
        pavement_share = _ONE if beyond < _KERB_M else (_JOINED if joint else _PAVED)
        out[j] = road_share if beyond < _ZERO else pavement_share


@compiled(**ROWWISE)
def surface_figure(texture: int, u: np.ndarray, v: np.ndarray, period: float, out: np.ndarray) -> None:
    """Whether places on a surface bear the texture's second colour, 0 to 1."""
    per_m = np.float32(1.0 / period)
    for j in range(len(out)):
        if texture == _BRICK:
            course = v[j] * _COURSES
            row = np.floor(course)
            along = u[j] * _BRICKS + _HALF * (row - _TWO * np.floor(row * _HALF))
            borne = (course - row < _MORTAR) | (along - np.floor(along) < _GAP)
        elif texture == _WINDOWS:
            across, up = u[j] * per_m, v[j] * _STOREYS
            across, up = across - np.floor(across), up - np.floor(up)
            borne = (across > _PANE_LEFT) & (across < _PANE_RIGHT) & (up > _SILL) & (up < _LINTEL)
        else:
            up = v[j] * per_m
            borne = up - np.floor(up) < _HALF
        out[j] = _ONE if borne else _ZERO
