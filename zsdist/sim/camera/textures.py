"""Numba kernels of textures: noise from a mipmap pyramid, and figures on grounds and surfaces."""

from functools import lru_cache

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.sim.camera.appearance import Pattern, Texture
from zsdist.sim.camera.kernels import ROWWISE

_TILES, _STRIPES, _CHECKER = int(Pattern.TILES), int(Pattern.STRIPES), int(Pattern.CHECKER)
_BRICK, _WINDOWS = int(Texture.BRICK), int(Texture.WINDOWS)

# Constants in single precision; a Python number in a kernel would be in double precision.
_ZERO, _ONE, _TWO, _HALF = (np.float32(value) for value in (0.0, 1.0, 2.0, 0.5))
_PER_UNIT = np.float32(1 / 127)
_JOINT, _DASH = np.float32(0.05), np.float32(0.6)  # joint of tiles, dash of a lane's line, as shares of a period
_COURSES, _BRICKS, _MORTAR, _GAP = (np.float32(value) for value in (1 / 0.2, 1 / 0.45, 0.12, 0.06))
_STOREYS = np.float32(1 / 1.1)
_GUTTER, _PAVED, _JOINED = (np.float32(value) for value in (-0.25, 0.75, 0.45))  # shares of the pavement's colour
_GUTTER_M, _KERB_M, _LINE = (np.float32(value) for value in (0.25, 0.15, 0.06))  # widths; half the width of a line
_DASHES, _SLAB_JOINT = np.float32(1 / 3.0), np.float32(0.04)  # dashes per metre; joint as a share of a slab
_PANE_LEFT, _PANE_RIGHT, _SILL, _LINTEL = (np.float32(value) for value in (0.25, 0.75, 0.35, 0.85))

_NOISE_SIZE = 512
_NOISE_LEVELS = 8
_RUN = 32  # number of pixels in a row that use the same level of the pyramid
_SPECTRA = (((1.6, 1.0),), ((0.8, 1.0), (0.25, 0.6)))  # clouds, grain: exponents of 1 / frequency and their weights
CLOUDS, GRAIN = range(2)


@lru_cache(maxsize=1)
def noise_pyramid() -> np.ndarray:
    """Return tiling noise of each spectrum at each level of resolution, `(2, sum of sizes)` int8, always the same.

    Small numbers (int8, 127 is 1) keep all of it in the processor's cache.
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
    """Write to `out` the noise at points, from the pyramid's level whose texels are about as large as a pixel.

    A run of `_RUN` pixels uses one level, the one for its middle. Successive runs with the same level are read
    together.

    Args:
        pyramid: noise of one spectrum, a row of `noise_pyramid`.
        u: `(n,)` float32, first coordinate of the points in metres.
        v: `(n,)` float32, second coordinate of the points in metres.
        per_m: number of texels per metre at full resolution.
        footprint: `(n,)` size of a pixel at each point, metres.
        at: `(n,)` uint32, buffer.
        out: `(n,)`, written: -1 to 1.
    """
    n = len(out)
    first, halvings = 0, _halvings(footprint[min(_RUN, n) // 2] * per_m) if n else 0
    for next_run in range(_RUN, n, _RUN):
        run_halvings = _halvings(footprint[(next_run + min(next_run + _RUN, n)) // 2] * per_m)
        if run_halvings != halvings:
            _texels(pyramid, halvings, per_m, u[first:next_run], v[first:next_run], at, out[first:next_run])
            first, halvings = next_run, run_halvings
    _texels(pyramid, halvings, per_m, u[first:], v[first:], at, out[first:])


@compiled(**ROWWISE)
def _halvings(texels: float) -> int:
    """Return the number of halvings after which a pixel of `texels` texels spans one texel or less."""
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
    # Two loops, since reads from scattered addresses would keep the compiler from vectorising the first.
    for j in range(len(out)):
        row = np.int32(np.floor(v[j] * texels)) & mask
        column = np.int32(np.floor(u[j] * texels)) & mask
        at[j] = np.uint32(row * stride + column)
    for j in range(len(out)):
        out[j] = np.float32(level[at[j]]) * _PER_UNIT


@compiled(**ROWWISE)
def ground_figure(pattern: int, x: np.ndarray, y: np.ndarray, period: float, out: np.ndarray) -> None:
    """Write to `out` the share of the pattern's colour at points on the ground, 0 to 1."""
    per_m, dash = np.float32(1.0 / period), np.float32(0.12 / period)
    for j in range(len(out)):
        u, v = x[j] * per_m, y[j] * per_m
        u, v = u - np.floor(u), v - np.floor(v)
        if pattern == _TILES:
            second_colour = (u < _JOINT) | (v < _JOINT)
        elif pattern == _STRIPES:
            second_colour = u < _HALF
        elif pattern == _CHECKER:
            second_colour = (u < _HALF) == (v < _HALF)
        else:
            second_colour = (u < dash) & (v < _DASH)
        out[j] = _ONE if second_colour else _ZERO


@compiled(**ROWWISE)
def road_figure(
    along: np.ndarray, left: np.ndarray, road: np.ndarray, slab_m: float, footprint: np.ndarray, out: np.ndarray
) -> None:
    """Write to `out` the share of the colour of kerbs and pavements at points; it is negative in a gutter.

    Lines finer than a pixel are left out.

    Args:
        along: `(n,)`, position along the road in metres.
        left: `(n,)`, distance to the left of the origin in metres.
        road: `(2,)`, distance of the road's middle to the left of the origin, and half the road's width, in metres.
        slab_m: side of the pavement's slabs, in metres.
        footprint: `(n,)` size of a pixel at each point, metres.
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
    """Write to `out` the share of the texture's second colour at points on a surface, 0 to 1."""
    per_m = np.float32(1.0 / period)
    for j in range(len(out)):
        if texture == _BRICK:
            course = v[j] * _COURSES
            row = np.floor(course)
            along = u[j] * _BRICKS + _HALF * (row - _TWO * np.floor(row * _HALF))
            second_colour = (course - row < _MORTAR) | (along - np.floor(along) < _GAP)
        elif texture == _WINDOWS:
            across, up = u[j] * per_m, v[j] * _STOREYS
            across, up = across - np.floor(across), up - np.floor(up)
            second_colour = (across > _PANE_LEFT) & (across < _PANE_RIGHT) & (up > _SILL) & (up < _LINTEL)
        else:
            up = v[j] * per_m
            second_colour = up - np.floor(up) < _HALF
        out[j] = _ONE if second_colour else _ZERO
