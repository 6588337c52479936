"""Numba kernels that colour the pixels of the ray caster: light, shadow, texture, haze.

A picture is coloured row by row: the sky and the ground each over their span of columns, then each primitive over the
span in which it was found. The intermediate values of a row (light, noise, figures) are stored in scratch rows, so that
every inner loop is short, in single precision and without branches, and the compiler vectorises it. For that, the
compiler must know that the rows which a loop reads and writes do not overlap. It checks at most eight pairs, so a loop
writes one row, or it writes two rows and reads at most three.
"""

import math
from typing import NamedTuple

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.sim.camera.appearance import Pattern, Texture
from zsdist.sim.camera.kernels import GROUND, LEVEL, ROWWISE, SKY, row_directions, widened
from zsdist.sim.camera.normals import box_normals, ellipsoid_normals, frustum_normals
from zsdist.sim.camera.primitives import Form
from zsdist.sim.camera.shadows import darken, sunshine
from zsdist.sim.camera.textures import CLOUDS, GRAIN, ground_figure, noise, road_figure, surface_figure

_FRUSTUM, _ELLIPSOID, _BARK = int(Form.FRUSTUM), int(Form.ELLIPSOID), int(Texture.BARK)
_KERBS = int(Pattern.KERBS)

# Constants in single precision; a Python number in a kernel would be in double precision.
_ZERO, _ONE, _HALF, _WHITE = (np.float32(value) for value in (0.0, 1.0, 0.5, 255.0))
_LOWEST, _OVERCAST = np.float32(0.02), np.float32(0.2)
_FLAT, _FINE = np.float32(0.7), np.float32(0.1)
_SIDE, _TOP, _FOOT, _OPEN, _PER_FOOT = (np.float32(value) for value in (0.75, 0.25, 0.6, 0.4, 1 / 0.35))
_NEVER = np.float32(1e9)
_BARK_STRETCH = np.float32(0.2)


# numba's cache refers to these classes by name: after one is renamed or removed, delete the cached files.
class Palette(NamedTuple):
    """Arrays of an `Appearance`, in a form that kernels accept."""

    materials: np.ndarray
    ground: np.ndarray
    sky: np.ndarray
    light: np.ndarray


class Shadows(NamedTuple):
    """Shadows on the ground.

    Attributes:
        corners: `(m, m)` uint32 from `shadow_corners`, from `-half_m` to `half_m` in x and y.
        half_m: half the side of the shadow map, in metres.
        discs: `(W, 3)`, x, y and radius in metres of walking obstacles, which have no shadow in the map.
    """

    corners: np.ndarray
    half_m: float
    discs: np.ndarray


class Scratch(NamedTuple):
    """Buffers for the intermediate values of a row: `rows` `(12, n)` float32 and `indices` `(n,)` uint32."""

    rows: np.ndarray
    indices: np.ndarray


class Span(NamedTuple):
    """Pixels of a row: tangents `left` `(s,)` float32 and `up` of their rays, and `step`, the tangent of a pixel."""

    left: np.ndarray
    up: float
    step: float


class PrimitiveFrame(NamedTuple):
    """Frame of a primitive: cosine and sine of its heading, offset of the camera (m), and the sun in this frame."""

    cos: np.float32
    sin: np.float32
    x: np.float32
    y: np.float32
    sun_x: np.float32
    sun_y: np.float32


@compiled(**ROWWISE)
def _packed(red: np.float32, green: np.float32, blue: np.float32) -> np.int32:
    """Return a colour, each part in 0 to 1, as the bytes red, green, blue, 0 of a little-endian number."""
    first = np.int32(min(max(red, _ZERO), _ONE) * _WHITE)
    second = np.int32(min(max(green, _ZERO), _ONE) * _WHITE)
    third = np.int32(min(max(blue, _ZERO), _ONE) * _WHITE)
    return first | (second << np.int32(8)) | (third << np.int32(16))


@compiled(**ROWWISE)
def _sky(
    pyramid: np.ndarray, palette: Palette, axes: np.ndarray, span: Span, scratch: Scratch, line: np.ndarray
) -> None:
    """Colour a span of a row as sky: clear overhead, pale at the horizon, clouds on a plane far above."""
    sky, a, work, n = palette.sky, span.left, scratch.rows, len(span.left)
    up, u, v, footprint, cloud = work[0, :n], work[1, :n], work[2, :n], work[3, :n], work[4, :n]
    x0, y0, z0, x1, y1, z1 = row_directions(axes[0], axes[1], axes[2], span.up)
    for j in range(n):
        dx, dy, dz = x0 + a[j] * x1, y0 + a[j] * y1, z0 + a[j] * z1
        rise = max(dz, _LOWEST) / np.sqrt(dx * dx + dy * dy + dz * dz)
        up[j], footprint[j] = rise, _LOWEST / rise
    for j in range(n):
        u[j], v[j] = (x0 + a[j] * x1) / up[j], (y0 + a[j] * y1) / up[j]
    noise(pyramid[CLOUDS], u, v, 33.0, footprint, scratch.indices, cloud)
    amount = np.float32(sky[6])
    r0, g0, b0 = np.float32(sky[0]), np.float32(sky[1]), np.float32(sky[2])
    r1, g1, b1 = np.float32(sky[3] - sky[0]), np.float32(sky[4] - sky[1]), np.float32(sky[5] - sky[2])
    gain = np.float32(palette.light[6])
    for j in range(n):
        clear = up[j] * (_ONE - min(amount * max(cloud[j] + _OVERCAST, _ZERO), _ONE))
        line[j] = _packed((r0 + r1 * clear) * gain, (g0 + g1 * clear) * gain, (b0 + b1 * clear) * gain)


@compiled(**ROWWISE)
def _ground(
    pyramid: np.ndarray,
    palette: Palette,
    shadows: Shadows,
    origin: np.ndarray,
    axes: np.ndarray,
    span: Span,
    scratch: Scratch,
    line: np.ndarray,
) -> None:
    """Colour a span of a row as ground: shadows, patches, a pattern, grain."""
    ground, sky, light = palette.ground, palette.sky, palette.light
    a, step, work, at, n = span.left, span.step, scratch.rows, scratch.indices, len(span.left)
    x, y, u, v = work[0, :n], work[1, :n], work[2, :n], work[3, :n]
    footprint, lit, patch, grain, figure = work[4, :n], work[5, :n], work[6, :n], work[7, :n], work[8, :n]
    x0, y0, z0, x1, y1, z1 = row_directions(axes[0], axes[1], axes[2], span.up)
    ox, oy, oz, pixel = np.float32(origin[0]), np.float32(origin[1]), np.float32(origin[2]), np.float32(step)
    cos, sin = np.float32(ground[10]), np.float32(ground[11])
    for j in range(n):
        t = -oz / min(z0 + a[j] * z1, -LEVEL)
        x[j], y[j] = ox + t * (x0 + a[j] * x1), oy + t * (y0 + a[j] * y1)
    for j in range(n):
        footprint[j] = pixel * (-oz / min(z0 + a[j] * z1, -LEVEL))
    for j in range(n):
        u[j], v[j] = cos * x[j] + sin * y[j], cos * y[j] - sin * x[j]
    sunshine(shadows.corners, shadows.half_m, x, y, at, lit)
    for k in range(len(shadows.discs)):
        darken(shadows.discs[k], x, y, lit)
    noise(pyramid[CLOUDS], u, v, 17.0, footprint, at, patch)
    noise(pyramid[GRAIN], u, v, 1.0 / ground[8], footprint, at, grain)
    pattern, finest = int(ground[6]), np.float32(0.25 * ground[9])  # a figure finer than two pixels would flicker
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
        figure[j] = strength * figure[j] if footprint[j] < finest else _ZERO
        lit[j] = (_ONE + roughness * grain[j]) * lit[j] * brightness
    r0, g0, b0 = np.float32(ground[0]), np.float32(ground[1]), np.float32(ground[2])
    r1, g1, b1 = np.float32(ground[3]) - r0, np.float32(ground[4]) - g0, np.float32(ground[5]) - b0
    r2, g2, b2 = np.float32(ground[14]), np.float32(ground[15]), np.float32(ground[16])
    far = np.float32(light[6])
    r3, g3, b3 = far * np.float32(sky[0]), far * np.float32(sky[1]), far * np.float32(sky[2])
    for j in range(n):
        share = min(max(_HALF + contrast * patch[j], _ZERO), _ONE)
        red, green, blue = r0 + r1 * share, g0 + g1 * share, b0 + b1 * share
        red = (red + (r2 - red) * figure[j]) * lit[j]
        green = (green + (g2 - green) * figure[j]) * lit[j]
        blue = (blue + (b2 - blue) * figure[j]) * lit[j]
        t = footprint[j] * per_pixel
        fog = t / (t + haze)
        line[j] = _packed(red + (r3 - red) * fog, green + (g3 - green) * fog, blue + (b3 - blue) * fog)


@compiled(**ROWWISE)
def _frame(row: np.ndarray, origin: np.ndarray, light: np.ndarray) -> PrimitiveFrame:
    """Return the frame of a primitive, from its row of `Primitives.rows`."""
    co, si = math.cos(row[6]), math.sin(row[6])
    sun_x, sun_y = co * light[0] + si * light[1], co * light[1] - si * light[0]
    return PrimitiveFrame(
        np.float32(co),
        np.float32(si),
        np.float32(origin[0] - row[0]),
        np.float32(origin[1] - row[1]),
        np.float32(sun_x),
        np.float32(sun_y),
    )


@compiled(**ROWWISE)
def _surface(
    pyramid: np.ndarray,
    form: int,
    row: np.ndarray,
    material: np.ndarray,
    light: np.ndarray,
    frame: PrimitiveFrame,
    origin: np.ndarray,
    axes: np.ndarray,
    span: Span,
    t: np.ndarray,
    scratch: Scratch,
) -> None:
    """Compute the light, haze and share of the second colour of one primitive along a span of a row.

    The results are in rows 5, 7 and 8 of `scratch`.
    """
    a, work, at, n = span.left, scratch.rows, scratch.indices, len(span.left)
    x, y, u, v, footprint = work[0, :n], work[1, :n], work[2, :n], work[3, :n], work[4, :n]
    lit, z, grain, figure = work[5, :n], work[6, :n], work[7, :n], work[8, :n]
    nx, ny, nz = work[9, :n], work[10, :n], work[11, :n]
    x0, y0, z0, x1, y1, z1 = row_directions(axes[0], axes[1], axes[2], span.up)
    co, si, ox, oy, sun_x, sun_y = frame
    oz, pixel = np.float32(origin[2]), np.float32(span.step)
    for j in range(n):
        wx, wy = ox + t[j] * (x0 + a[j] * x1), oy + t[j] * (y0 + a[j] * y1)
        x[j], y[j] = co * wx + si * wy, co * wy - si * wx
    for j in range(n):
        z[j], footprint[j] = oz + t[j] * (z0 + a[j] * z1), t[j] * pixel
    if form == _FRUSTUM:
        frustum_normals(row, x, y, z, nx, ny, nz)
    elif form == _ELLIPSOID:
        ellipsoid_normals(row, x, y, z, nx, ny, nz)
    else:
        box_normals(row, x, y, z, nx, ny, nz)
    sun_z, base, shift = np.float32(light[2]), np.float32(row[2]), np.float32(material[9])
    ambient, sunlight = np.float32(light[3] * light[6]), np.float32(light[4] * light[6])
    for j in range(n):
        facing = max(nx[j] * sun_x + ny[j] * sun_y + nz[j] * sun_z, _ZERO)
        light_here = ambient * (_SIDE + _TOP * nz[j]) + sunlight * facing
        lit[j] = light_here * (_FOOT + _OPEN * min(z[j] * _PER_FOOT, _ONE))  # the ground hides half of the sky
    for j in range(n):
        along = (abs(nx[j]) > abs(ny[j])) & (abs(nz[j]) <= _FLAT)
        u[j] = shift + (y[j] if along else x[j])
    for j in range(n):
        v[j] = y[j] if abs(nz[j]) > _FLAT else z[j] - base
    texture = int(material[6])
    stretch = _BARK_STRETCH if texture == _BARK else _ONE
    if texture > _BARK:
        surface_figure(texture, u, v, material[10], figure)
        for j in range(n):
            figure[j] = figure[j] if (footprint[j] < _FINE) & (abs(nz[j]) <= _FLAT) else _ZERO
    else:
        figure[:] = _ZERO
    for j in range(n):
        v[j] *= stretch
        footprint[j] *= stretch
    noise(pyramid[GRAIN], u, v, 1.0 / material[8], footprint, at, grain)
    roughness, haze = np.float32(material[7]), np.float32(light[5])
    for j in range(n):
        lit[j] *= _ONE + roughness * grain[j]
        grain[j] = t[j] / (t[j] + haze)


@compiled(**ROWWISE)
def _paint(palette: Palette, work: np.ndarray, which: np.ndarray, p: int, line: np.ndarray) -> None:
    """Colour the pixels of a span of a row that show primitive `p`, from the values of `_surface`."""
    material, sky, gain, n = palette.materials[p], palette.sky, palette.light[6], len(which)
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


@compiled(**ROWWISE)
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
    work: np.ndarray,
    at: np.ndarray,
    image: np.ndarray,
) -> None:
    """Write the colour of every pixel, from the results of `kernels.cast`.

    The arguments are flat, since numba needs about 30 us per picture to unpack four named tuples from Python.

    Args:
        forms: shapes, as in `Primitives`.
        rows: positions and sizes, as in `Primitives`.
        materials: surfaces, as in `Appearance`.
        ground: ground, as in `Appearance`.
        sky: sky, as in `Appearance`.
        light: light, as in `Appearance`.
        shadow: shadow map, as in `Shadows.corners`.
        shadow_half: half the side of the shadow map, as in `Shadows.half_m`.
        discs: walking obstacles, as in `Shadows.discs`.
        pyramid: noise from `noise_pyramid`.
        origin: position of the camera, see `optics.mount`.
        axes: axes of the camera, see `optics.mount`.
        tangents: `(n,)` float32, from `optics.tangents`.
        depth: `(n, n)` float32, depth in metres along the camera's axis.
        index: `(n, n)` int32, number of the primitive, or `GROUND` or `SKY`.
        rectangles: `(P, 4)` int64, first and end row, first and end column in which each primitive is drawn.
        work: buffer, as in `Scratch.rows`; written.
        at: buffer, as in `Scratch.indices`; written.
        image: `(n, n)` int32, written: the bytes red, green, blue and 0 of each pixel.
    """
    palette, scratch = Palette(materials, ground, sky, light), Scratch(work, at)
    shadows = Shadows(shadow, shadow_half, discs)
    n = depth.shape[0]
    step = float(tangents[0] - tangents[n - 1]) / (n - 1)
    for i in range(n):
        up = float(tangents[i])
        first, last = _columns_of(index[i], GROUND)
        horizon = first < last
        if horizon:
            start, end = widened(first, last, n)
            span = Span(tangents[start:end], up, step)
            _ground(pyramid, palette, shadows, origin, axes, span, scratch, image[i, start:end])
        first, last = _columns_of(index[i], SKY)
        if first < last:
            if not horizon:  # in a row with both, the widened sky must not overwrite ground
                first, last = widened(first, last, n)
            span = Span(tangents[first:last], up, step)
            _sky(pyramid, palette, axes, span, scratch, image[i, first:last])
    for p in range(len(forms)):
        row0, row1, column0, column1 = rectangles[p]
        material, frame = palette.materials[p], _frame(rows[p], origin, palette.light)
        for i in range(row0, row1):
            first, last = _columns_of(index[i, column0:column1], p)
            if first < last:
                first, last = widened(first + column0, last + column0, n)
                span = Span(tangents[first:last], float(tangents[i]), step)
                t, which = depth[i, first:last], index[i, first:last]
                _surface(pyramid, forms[p], rows[p], material, palette.light, frame, origin, axes, span, t, scratch)
                _paint(palette, scratch.rows, which, p, image[i, first:last])


@compiled(**ROWWISE)
def _columns_of(index: np.ndarray, which: int) -> tuple[int, int]:
    """Return first and end of the shortest span of a row with every pixel of `which`; empty if there is none."""
    n, it = np.int32(len(index)), np.int32(which)
    first, last = n, np.int32(0)
    for j in range(len(index)):
        here, column = index[j] == it, np.int32(j)
        first = min(first, column if here else n)
        last = max(last, column + np.int32(1) if here else np.int32(0))
    return int(first), int(last)
