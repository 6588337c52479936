"""Numba kernels that colour what the ray caster found: light, shadow, texture, haze.

A picture is coloured row by row: the sky and the ground each over the columns they may take, then each primitive over
those in which it was found. What is needed of a row (light, noise, figures) stands in rows of numbers of its own, so
that every inner loop is short, in single precision and without branches, and the compiler does many pixels at once.
"""

import math

import numpy as np
from numba import njit

from zsdist.sim.camera.appearance import Pattern, Texture
from zsdist.sim.camera.kernels import FAST, GROUND, SKY, row_directions
from zsdist.sim.camera.primitives import Form
from zsdist.sim.camera.textures import CLOUDS, GRAIN, ground_figure, noise, road_figure, surface_figure

_FRUSTUM, _ELLIPSOID, _BARK = int(Form.FRUSTUM), int(Form.ELLIPSOID), int(Texture.BARK)
_KERBS = int(Pattern.KERBS)

# single precision, which a plain number in a kernel would not be
_ZERO, _ONE, _HALF, _WHITE = (np.float32(value) for value in (0.0, 1.0, 0.5, 255.0))
_LOWEST, _OVERCAST = np.float32(0.02), np.float32(0.2)
_SHADE, _LIGHTER = np.float32(0.55), np.float32(0.45)
_EDGE, _SMALL, _FLAT, _FINE = (np.float32(value) for value in (1e-4, 1e-12, 0.7, 0.1))
_SIDE, _TOP, _FOOT, _OPEN, _PER_FOOT = (np.float32(value) for value in (0.75, 0.25, 0.6, 0.4, 1 / 0.35))
_NEVER = np.float32(1e9)
_BARK_STRETCH = np.float32(0.2)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _packed(red: float, green: float, blue: float) -> int:
    """A colour, each part in 0 to 1, as the bytes red, green, blue, 0 of a little-endian number."""
    first = np.int32(min(max(red, _ZERO), _ONE) * _WHITE)
    second = np.int32(min(max(green, _ZERO), _ONE) * _WHITE)
    third = np.int32(min(max(blue, _ZERO), _ONE) * _WHITE)
    return first | (second << np.int32(8)) | (third << np.int32(16))


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _sky(pyramid, sky, gain, axes, b, a, work, line):  # noqa: ANN001, ANN202
    """Colours a stretch of a row as sky: clear overhead, pale at the horizon, clouds on a plane far up."""
    n = len(a)
    up, u, v, footprint, cloud = work[0, :n], work[1, :n], work[2, :n], work[3, :n], work[4, :n]
    x0, y0, z0, x1, y1, z1 = row_directions(axes[0], axes[1], axes[2], b)
    for j in range(n):
        dx, dy, dz = x0 + a[j] * x1, y0 + a[j] * y1, z0 + a[j] * z1
        up[j] = max(dz, _LOWEST) / np.sqrt(dx * dx + dy * dy + dz * dz)
        u[j], v[j], footprint[j] = dx / up[j], dy / up[j], _LOWEST / up[j]
    noise(pyramid[CLOUDS], u, v, 33.0, footprint, cloud)
    amount = np.float32(sky[6])
    r0, g0, b0 = np.float32(sky[0]), np.float32(sky[1]), np.float32(sky[2])
    r1, g1, b1 = np.float32(sky[3] - sky[0]), np.float32(sky[4] - sky[1]), np.float32(sky[5] - sky[2])
    gain = np.float32(gain)
    for j in range(n):
        clear = up[j] * (_ONE - min(amount * max(cloud[j] + _OVERCAST, _ZERO), _ONE))
        line[j] = _packed((r0 + r1 * clear) * gain, (g0 + g1 * clear) * gain, (b0 + b1 * clear) * gain)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _ground(pyramid, ground, sky, light, shadow, shadow_half, discs, origin, axes, b, a, step, work, line):  # noqa: ANN001, ANN202
    """Colours a stretch of a row as ground: shadows, patches, a pattern, grain."""
    n = len(a)
    x, y, u, v = work[0, :n], work[1, :n], work[2, :n], work[3, :n]
    footprint, lit, patch, grain, figure = work[4, :n], work[5, :n], work[6, :n], work[7, :n], work[8, :n]
    x0, y0, z0, x1, y1, z1 = row_directions(axes[0], axes[1], axes[2], b)
    ox, oy, oz, pixel = np.float32(origin[0]), np.float32(origin[1]), np.float32(origin[2]), np.float32(step)
    cos, sin = np.float32(ground[10]), np.float32(ground[11])
    for j in range(n):
        t = -oz / (z0 + a[j] * z1)
        x[j], y[j] = ox + t * (x0 + a[j] * x1), oy + t * (y0 + a[j] * y1)
        u[j], v[j] = cos * x[j] + sin * y[j], cos * y[j] - sin * x[j]
        footprint[j] = t * pixel
    _sunshine(shadow, shadow_half, x, y, lit)
    for k in range(len(discs)):
        _darken(discs[k], x, y, lit)
    noise(pyramid[CLOUDS], u, v, 17.0, footprint, patch)
    noise(pyramid[GRAIN], u, v, 1.0 / ground[8], footprint, grain)
    pattern, finest = int(ground[6]), np.float32(0.25 * ground[9])  # a finer figure than two pixels would shimmer
    if pattern == _KERBS:
        road_figure(u, v, ground[17:], ground[9], footprint, figure)
        finest = _NEVER
    elif pattern != 0:
        ground_figure(pattern, u, v, ground[9], figure)
    else:
        figure[:] = _ZERO
    strength, contrast, roughness = np.float32(ground[13]), np.float32(ground[12]), np.float32(ground[7])
    brightness = np.float32(light[6] * (light[3] + light[4] * light[2]))
    per_pixel, haze = np.float32(1.0 / step), np.float32(light[5])
    for j in range(n):
        borne = strength * figure[j] if footprint[j] < finest else _ZERO
        share = min(max(_HALF + contrast * patch[j], _ZERO), _ONE)
        t = footprint[j] * per_pixel
        lit[j] = (_ONE + roughness * grain[j]) * lit[j] * brightness
        patch[j], figure[j], grain[j] = share, borne, t / (t + haze)
    r0, g0, b0 = np.float32(ground[0]), np.float32(ground[1]), np.float32(ground[2])
    r1, g1, b1 = np.float32(ground[3]) - r0, np.float32(ground[4]) - g0, np.float32(ground[5]) - b0
    r2, g2, b2 = np.float32(ground[14]), np.float32(ground[15]), np.float32(ground[16])
    far = np.float32(light[6])
    r3, g3, b3 = far * np.float32(sky[0]), far * np.float32(sky[1]), far * np.float32(sky[2])
    for j in range(n):
        red, green, blue = r0 + r1 * patch[j], g0 + g1 * patch[j], b0 + b1 * patch[j]
        red = (red + (r2 - red) * figure[j]) * lit[j]
        green = (green + (g2 - green) * figure[j]) * lit[j]
        blue = (blue + (b2 - blue) * figure[j]) * lit[j]
        fog = grain[j]
        line[j] = _packed(red + (r3 - red) * fog, green + (g3 - green) * fog, blue + (b3 - blue) * fog)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _sunshine(shadow: np.ndarray, half_m: float, x: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    """How much light reaches places on the ground, between the cells of the shadow map."""
    cells = shadow.shape[0]
    flat = shadow.reshape(-1)
    per_m, middle, last = np.float32(cells / (2.0 * half_m)), np.float32(0.5 * cells - 0.5), np.float32(cells - 1.001)
    for j in range(len(out)):
        gx = min(max(x[j] * per_m + middle, _ZERO), last)
        gy = min(max(y[j] * per_m + middle, _ZERO), last)
        ix, iy = np.int32(gx), np.int32(gy)
        fx, fy = gx - np.float32(ix), gy - np.float32(iy)
        at = np.uint32(iy * np.int32(cells) + ix)
        near = flat[at] + fx * (flat[at + np.uint32(1)] - flat[at])
        at += np.uint32(cells)
        far = flat[at] + fx * (flat[at + np.uint32(1)] - flat[at])
        out[j] = near + fy * (far - near)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _darken(disc: np.ndarray, x: np.ndarray, y: np.ndarray, lit: np.ndarray) -> None:
    """The shade about the feet of something that walks: a disc of x, y, radius in metres."""
    dx, dy, per_radius = np.float32(disc[0]), np.float32(disc[1]), np.float32(1.0 / disc[2])
    for j in range(len(lit)):
        gap = np.sqrt((x[j] - dx) * (x[j] - dx) + (y[j] - dy) * (y[j] - dy)) * per_radius
        lit[j] *= min(_SHADE + _LIGHTER * max(gap - _ONE, _ZERO), _ONE)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _frame(row: np.ndarray, origin: np.ndarray, light: np.ndarray) -> tuple[float, float, float, float, float, float]:
    """Cosine and sine of a primitive's heading, the camera's place from its own, and the sun in its frame."""
    co, si = math.cos(row[6]), math.sin(row[6])
    sun_x, sun_y = co * light[0] + si * light[1], co * light[1] - si * light[0]
    return (
        np.float32(co),
        np.float32(si),
        np.float32(origin[0] - row[0]),
        np.float32(origin[1] - row[1]),
        np.float32(sun_x),
        np.float32(sun_y),
    )


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _surface(pyramid, form, row, material, light, frame, height, axes, b, a, step, t, work):  # noqa: ANN001, ANN202
    """What the surface of one primitive needs to be coloured along a stretch of a row.

    Leaves in `work` the light, the share of the second colour and the haze of each pixel, rows 5, 8 and 7.
    """
    n = len(a)
    x, y, u, v, footprint = work[0, :n], work[1, :n], work[2, :n], work[3, :n], work[4, :n]
    lit, z, grain, figure, upright = work[5, :n], work[6, :n], work[7, :n], work[8, :n], work[9, :n]
    x0, y0, z0, x1, y1, z1 = row_directions(axes[0], axes[1], axes[2], b)
    co, si, ox, oy, sun_x, sun_y = frame
    oz, base, pixel = np.float32(height), np.float32(row[2]), np.float32(step)
    for j in range(n):
        wx, wy = ox + t[j] * (x0 + a[j] * x1), oy + t[j] * (y0 + a[j] * y1)
        x[j], y[j], z[j] = co * wx + si * wy, co * wy - si * wx, oz + t[j] * (z0 + a[j] * z1)
        footprint[j] = t[j] * pixel
    size0, size1, size2 = np.float32(row[3]), np.float32(row[4]), np.float32(row[5])
    sun_z = np.float32(light[2])
    ambient, sunlight = np.float32(light[3] * light[6]), np.float32(light[4] * light[6])
    shift = np.float32(material[9])
    slope = (size2 - size1) / size0
    inverse0, inverse1, inverse2 = _ONE / (size0 * size0), _ONE / (size1 * size1), _ONE / (size2 * size2)
    for j in range(n):
        lx, ly, lz = x[j], y[j], z[j] - base
        if form == _FRUSTUM:
            lid = lz > size0 - _EDGE
            nx, ny = _ZERO if lid else lx, _ZERO if lid else ly
            nz = _ONE if lid else -slope * np.sqrt(lx * lx + ly * ly)
        elif form == _ELLIPSOID:
            nx, ny, nz = lx * inverse0, ly * inverse1, lz * inverse2
        else:
            qx, qy, qz = abs(lx) - size1, abs(ly) - size2, lz - size0
            lid = (qz > qx) & (qz > qy)
            side = (qx > qy) & ~lid
            nx = (_ONE if lx > _ZERO else -_ONE) if side else _ZERO
            ny = _ZERO if side | lid else (_ONE if ly > _ZERO else -_ONE)
            nz = _ONE if lid else _ZERO
        norm = _ONE / np.sqrt(nx * nx + ny * ny + nz * nz + _SMALL)
        nx, ny, nz = nx * norm, ny * norm, nz * norm
        facing = max(nx * sun_x + ny * sun_y + nz * sun_z, _ZERO)
        light_here = ambient * (_SIDE + _TOP * nz) + sunlight * facing
        lit[j] = light_here * (_FOOT + _OPEN * min(z[j] * _PER_FOOT, _ONE))  # near the ground the sky is half hidden
        flat = abs(nz) > _FLAT
        along = abs(nx) > abs(ny)
        u[j] = shift + (ly if along & ~flat else lx)
        v[j] = ly if flat else lz
        upright[j] = _ZERO if flat else _ONE
    texture = int(material[6])
    stretch = _BARK_STRETCH if texture == _BARK else _ONE
    if texture > _BARK:
        surface_figure(texture, u, v, material[10], figure)
        for j in range(n):
            figure[j] = figure[j] * upright[j] if footprint[j] < _FINE else _ZERO
    else:
        figure[:] = _ZERO
    for j in range(n):
        v[j] *= stretch
        footprint[j] *= stretch
    noise(pyramid[GRAIN], u, v, 1.0 / material[8], footprint, grain)
    roughness, haze = np.float32(material[7]), np.float32(light[5])
    for j in range(n):
        lit[j] *= _ONE + roughness * grain[j]
        grain[j] = t[j] / (t[j] + haze)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _paint(material, sky, gain, work, which, p, line):  # noqa: ANN001, ANN202
    """Colours those pixels of a stretch of a row in which primitive `p` was found, as `_surface` left them."""
    n = len(which)
    lit, fog, figure = work[5, :n], work[7, :n], work[8, :n]
    r0, g0, b0 = np.float32(material[0]), np.float32(material[1]), np.float32(material[2])
    r1, g1, b1 = np.float32(material[3]) - r0, np.float32(material[4]) - g0, np.float32(material[5]) - b0
    r3, g3, b3 = np.float32(sky[0] * gain), np.float32(sky[1] * gain), np.float32(sky[2] * gain)
    for j in range(n):
        red = (r0 + r1 * figure[j]) * lit[j]
        green = (g0 + g1 * figure[j]) * lit[j]
        blue = (b0 + b1 * figure[j]) * lit[j]
        colour = _packed(red + (r3 - red) * fog[j], green + (g3 - green) * fog[j], blue + (b3 - blue) * fog[j])
        line[j] = colour if which[j] == p else line[j]


@njit(cache=True, fastmath=FAST, error_model="numpy")
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
    tangents: np.ndarray,
    depth: np.ndarray,
    index: np.ndarray,
    rectangles: np.ndarray,
    image: np.ndarray,
) -> None:
    """Fill `image` `(n, n)` int32, a packed colour a pixel, from what `kernels.cast` left.

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
        tangents: `(n,)` float32, from `optics.tangents`.
        depth: `(n, n)` metres along the axis.
        index: `(n, n)` which primitive, or `GROUND` or `SKY`.
        rectangles: `(P, 4)` rows and columns within which each primitive's picture lies.
        image: `(n, n)` int32, written: the bytes red, green, blue and 0 of each pixel.
    """
    n = depth.shape[0]
    step = float(tangents[0] - tangents[n - 1]) / (n - 1)
    work = np.empty((10, n), np.float32)
    for i in range(n):
        b = float(tangents[i])
        first, last = _stretch(index[i], GROUND)
        if first < last:
            _ground(
                pyramid, ground, sky, light, shadow, shadow_half, discs, origin, axes, b, tangents[first:last], step,
                work, image[i, first:last],
            )  # fmt: skip
        first, last = _stretch(index[i], SKY)
        if first < last:
            _sky(pyramid, sky, light[6], axes, b, tangents[first:last], work, image[i, first:last])
    for p in range(len(forms)):
        row0, row1, column0, column1 = rectangles[p]
        frame = _frame(rows[p], origin, light)
        for i in range(row0, row1):
            first, last = _stretch(index[i, column0:column1], p)
            if first < last:
                first, last = first + column0, last + column0
                t, which = depth[i, first:last], index[i, first:last]
                _surface(
                    pyramid, forms[p], rows[p], materials[p], light, frame, origin[2], axes, float(tangents[i]),
                    tangents[first:last], step, t, work,
                )  # fmt: skip
                _paint(materials[p], sky, light[6], work, which, p, image[i, first:last])


@njit(cache=True)
def _stretch(index: np.ndarray, which: int) -> tuple[int, int]:
    """The least stretch of a row, first and end, that holds every pixel of `which`; empty where there is none."""
    first, last = 0, len(index)
    while first < last and index[first] != which:
        first += 1
    while last > first and index[last - 1] != which:
        last -= 1
    return first, last
