"""Numba kernel that colours what the ray caster found: light, shadow, texture, haze."""

import math
from functools import lru_cache

import numpy as np
from numba import njit

from zsdist.sim.camera.appearance import Pattern, Texture
from zsdist.sim.camera.kernels import _FAST, GROUND, SKY
from zsdist.sim.camera.primitives import Form

_FRUSTUM, _ELLIPSOID = int(Form.FRUSTUM), int(Form.ELLIPSOID)
_TILES, _STRIPES, _CHECKER, _LANES = int(Pattern.TILES), int(Pattern.STRIPES), int(Pattern.CHECKER), int(Pattern.LANES)
_KERBS = int(Pattern.KERBS)
_BARK, _BRICK, _WINDOWS, _BANDS = int(Texture.BARK), int(Texture.BRICK), int(Texture.WINDOWS), int(Texture.BANDS)

_NOISE_SIZE = 512
_NOISE_LEVELS = 8
_SPECTRA = (((1.6, 1.0),), ((0.8, 1.0), (0.25, 0.6)))  # of clouds and of grain: exponents of 1 / frequency, shares
_CLOUDS, _GRAIN = range(2)


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


@njit(cache=True, fastmath=_FAST, error_model="numpy", inline="always")
def _noise(pyramid: np.ndarray, spectrum: int, u: float, v: float, per_m: float, footprint: float) -> float:
    """Noise at a place in metres, of `per_m` texels a metre, from the halving whose texel is about the pixel's size."""
    size, start, level = _NOISE_SIZE, 0, 1
    while footprint * per_m > 1.0 and level < _NOISE_LEVELS:
        start += size * size
        size >>= 1
        per_m *= 0.5
        level += 1
    i = math.floor(v * per_m) & (size - 1)
    j = math.floor(u * per_m) & (size - 1)
    return pyramid[spectrum, start + i * size + j] * (1.0 / 127.0)


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _figure(texture: int, u: float, v: float, period: float) -> float:
    """Whether a place on a surface bears the texture's second colour, 0 to 1."""
    if texture == _BRICK:
        course = math.floor(v / 0.2)
        along = u / 0.45 + 0.5 * (course - 2.0 * math.floor(course / 2.0))
        return 1.0 if v / 0.2 - course < 0.12 or along - math.floor(along) < 0.06 else 0.0
    if texture == _WINDOWS:
        across, up = u / period, v / 1.1
        across, up = across - math.floor(across), up - math.floor(up)
        return 1.0 if 0.25 < across < 0.75 and 0.35 < up < 0.85 else 0.0
    if texture == _BANDS:
        up = v / period
        return 1.0 if up - math.floor(up) < 0.5 else 0.0
    return 0.0


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _ground_figure(pattern: int, x: float, y: float, period: float) -> float:
    """Whether a place on the ground bears the pattern's second colour, 0 to 1."""
    u, v = x / period, y / period
    u, v = u - math.floor(u), v - math.floor(v)
    if pattern == _TILES:
        return 1.0 if u < 0.05 or v < 0.05 else 0.0
    if pattern == _STRIPES:
        return 1.0 if u < 0.5 else 0.0
    if pattern == _CHECKER:
        return 1.0 if (u < 0.5) == (v < 0.5) else 0.0
    if pattern == _LANES:
        return 1.0 if u < 0.12 / period and v < 0.6 else 0.0
    return 0.0


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _road_figure(along: float, left: float, half: float, slab: float, footprint: float) -> float:
    """How far a place has the colour of kerbs and pavements, below 0 for a gutter; lines finer than a pixel are out.

    Args:
        along: in metres.
        left: of the road's middle, in metres.
        half: of the road's width, in metres.
        slab: side of the pavement's slabs, in metres.
        footprint: of a pixel, in metres.
    """
    beyond = abs(left) - half
    if beyond < 0.0:
        if beyond > -0.25:
            return -0.25
        dash = along / 3.0
        return 1.0 if footprint < 0.06 and abs(left) < 0.06 and dash - math.floor(dash) < 0.5 else 0.0
    if beyond < 0.15:
        return 1.0
    u, v = along / slab, beyond / slab
    joint = u - math.floor(u) < 0.04 or v - math.floor(v) < 0.04
    return 0.45 if joint and footprint < 0.05 * slab else 0.75


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def shade(
    forms: np.ndarray,
    rows: np.ndarray,
    materials: np.ndarray,
    ground: np.ndarray,
    sky: np.ndarray,
    light: np.ndarray,
    shadow: np.ndarray,
    shadow_half: float,
    discs: np.ndarray,
    pyramid: np.ndarray,
    origin: np.ndarray,
    axes: np.ndarray,
    tangent: float,
    depth: np.ndarray,
    index: np.ndarray,
    image: np.ndarray,
) -> None:
    """Fill `image` `(n, n, 3)` uint8 from `depth` and `index` as `kernels.cast` left them.

    Args:
        forms: see `Primitives`.
        rows: see `Primitives`.
        materials: see `Appearance`.
        ground: see `Appearance`.
        sky: see `Appearance`.
        light: see `Appearance`.
        shadow: `(m, m)` from `kernels.shadow_map`, over plus and minus `shadow_half` metres.
        shadow_half: in metres.
        discs: `(W, 3)` x, y, radius of what walks and so has no shadow in the map.
        pyramid: from `noise_pyramid`.
        origin: of the camera, see `optics.mount`.
        axes: of the camera, see `optics.mount`.
        tangent: of half the field of view.
        depth: `(n, n)` metres along the axis.
        index: `(n, n)` which primitive, or `GROUND` or `SKY`.
        image: `(n, n, 3)` uint8, written.
    """
    n = depth.shape[0]
    step = 2.0 * tangent / n
    sun_x, sun_y, sun_z, ambient, sunlight, haze_m, gain = light
    cells = shadow.shape[0]
    cell = 2.0 * shadow_half / cells
    turns = np.empty((len(rows), 2))
    for p in range(len(rows)):
        turns[p, 0], turns[p, 1] = math.cos(rows[p, 6]), math.sin(rows[p, 6])
    for i in range(n):
        b = tangent - step * (i + 0.5)
        for j in range(n):
            a = tangent - step * (j + 0.5)
            dx = axes[0, 0] + a * axes[1, 0] + b * axes[2, 0]
            dy = axes[0, 1] + a * axes[1, 1] + b * axes[2, 1]
            dz = axes[0, 2] + a * axes[1, 2] + b * axes[2, 2]
            t, p = depth[i, j], index[i, j]
            if p == SKY:
                up = max(dz, 0.02) / math.sqrt(dx * dx + dy * dy + dz * dz)
                cloud = sky[6] * max(_noise(pyramid, _CLOUDS, dx / up, dy / up, 33.0, 0.02 / up) + 0.2, 0.0)
                for c in range(3):
                    value = sky[c] + (sky[3 + c] - sky[c]) * up
                    value += (sky[c] - value) * min(cloud, 1.0)
                    image[i, j, c] = np.uint8(min(max(value * gain, 0.0), 1.0) * 255.0)
                continue
            x, y, z = origin[0] + t * dx, origin[1] + t * dy, origin[2] + t * dz
            footprint = t * step
            if p == GROUND:
                lit = 1.0
                gx, gy = (x + shadow_half) / cell - 0.5, (y + shadow_half) / cell - 0.5
                if 0.0 <= gx < cells - 1 and 0.0 <= gy < cells - 1:
                    ix, iy = int(gx), int(gy)
                    fx, fy = gx - ix, gy - iy
                    lit = (1 - fy) * ((1 - fx) * shadow[iy, ix] + fx * shadow[iy, ix + 1]) + fy * (
                        (1 - fx) * shadow[iy + 1, ix] + fx * shadow[iy + 1, ix + 1]
                    )
                for k in range(len(discs)):
                    gap = math.sqrt((x - discs[k, 0]) ** 2 + (y - discs[k, 1]) ** 2) / discs[k, 2]
                    if gap < 2.0:
                        lit *= 0.55 + 0.45 * max(gap - 1.0, 0.0)
                lit *= gain * (ambient + sunlight * sun_z)
                cos, sin = ground[10], ground[11]
                u, v = cos * x + sin * y, cos * y - sin * x
                patch = 0.5 + ground[12] * _noise(pyramid, _CLOUDS, u, v, 17.0, footprint)
                share = min(max(patch, 0.0), 1.0)
                figure = 0.0
                # A figure finer than two pixels is left out: it would shimmer.
                if ground[6] == _KERBS:
                    figure = ground[13] * _road_figure(u, v - ground[17], ground[18], ground[9], footprint)
                elif ground[6] != 0.0 and footprint < 0.25 * ground[9]:
                    figure = ground[13] * _ground_figure(int(ground[6]), u, v, ground[9])
                grain = 1.0 + ground[7] * _noise(pyramid, _GRAIN, u, v, 1.0 / ground[8], footprint)
                fog = t / (t + haze_m)
                for c in range(3):
                    value = ground[c] + (ground[3 + c] - ground[c]) * share
                    value += (ground[14 + c] - value) * figure
                    value *= grain * lit
                    value += (sky[c] * gain - value) * fog
                    image[i, j, c] = np.uint8(min(max(value, 0.0), 1.0) * 255.0)
                continue
            row = rows[p]
            co, si = turns[p, 0], turns[p, 1]
            wx, wy = x - row[0], y - row[1]
            lx, ly, lz = co * wx + si * wy, co * wy - si * wx, z - row[2]
            nx, ny, nz = 0.0, 0.0, 0.0
            if forms[p] == _FRUSTUM:
                if lz > row[3] - 1e-4:
                    nz = 1.0
                else:
                    slope = (row[5] - row[4]) / row[3]
                    nx, ny, nz = lx, ly, -slope * math.sqrt(lx * lx + ly * ly)
            elif forms[p] == _ELLIPSOID:
                nx, ny, nz = lx / (row[3] * row[3]), ly / (row[4] * row[4]), lz / (row[5] * row[5])
            else:
                qx, qy, qz = abs(lx) - row[4], abs(ly) - row[5], lz - row[3]
                if qz > qx and qz > qy:
                    nz = 1.0
                elif qx > qy:
                    nx = math.copysign(1.0, lx)
                else:
                    ny = math.copysign(1.0, ly)
            norm = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz + 1e-12)
            nx, ny, nz = nx * norm, ny * norm, nz * norm
            facing = (co * nx - si * ny) * sun_x + (si * nx + co * ny) * sun_y + nz * sun_z
            lit = gain * (ambient * (0.75 + 0.25 * nz) + sunlight * max(facing, 0.0))
            lit *= 0.6 + 0.4 * min(z / 0.35, 1.0)  # near the ground the sky is half hidden
            material = materials[p]
            if abs(nz) > 0.7:
                u, v = lx, ly
            elif abs(nx) > abs(ny):
                u, v = ly, lz
            else:
                u, v = lx, lz
            u, v = u + material[9], v
            texture = int(material[6])
            figure = 0.0
            if texture > _BARK and abs(nz) < 0.7 and footprint < 0.1:
                figure = _figure(texture, u, v, material[10])
            stretch = 0.2 if texture == _BARK else 1.0
            grain = 1.0 + material[7] * _noise(pyramid, _GRAIN, u, v * stretch, 1.0 / material[8], footprint * stretch)
            fog = t / (t + haze_m)
            for c in range(3):
                value = material[c] + (material[3 + c] - material[c]) * figure
                value *= grain * lit
                value += (sky[c] * gain - value) * fog
                image[i, j, c] = np.uint8(min(max(value, 0.0), 1.0) * 255.0)
