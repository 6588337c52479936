"""Numba kernels of shadows on the ground: a shadow map, computed once for a scene, and its use in each picture."""

import math

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.sim.camera.kernels import ELLIPSOID, FAST, FRUSTUM, NEAR_M, ROWWISE, SKY_DEPTH_M, extents, into_frame
from zsdist.sim.camera.primitives import Form

_IN_SHADOW, _CONTACT_M = np.float32(0.55), 0.5
_BOX = int(Form.BOX)

# Constants in single precision; a Python number in a kernel would be in double precision.
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_SHADE, _LIGHTER = np.float32(0.55), np.float32(0.45)
_PER_LEVEL = np.float32(1 / 255)
_BYTE, _TWO_BYTES, _THREE_BYTES, _LAST_BYTE = (np.uint32(value) for value in (8, 16, 24, 255))


@compiled(fastmath=FAST, error_model="numpy")
def _enter(form: int, row: np.ndarray, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> float:
    """Return the distance at which a ray in a primitive's own frame first meets it; -1 if it never does."""
    if form == FRUSTUM:
        height, r0 = row[3], row[4]
        k = (row[5] - r0) / height
        at = r0 + k * oz
        a = dx * dx + dy * dy - k * k * dz * dz
        b = ox * dx + oy * dy - k * dz * at
        c = ox * ox + oy * oy - at * at
        discriminant = b * b - a * c
        best = -1.0
        if discriminant >= 0.0 and a != 0.0:
            root = math.sqrt(discriminant)
            near, far = (-b - root) / a, (-b + root) / a
            if near > far:
                near, far = far, near
            if near > NEAR_M and 0.0 <= oz + near * dz <= height:
                best = near
            elif far > NEAR_M and 0.0 <= oz + far * dz <= height:
                best = far
        if oz > height and dz < 0.0:
            t = (height - oz) / dz
            px, py = ox + t * dx, oy + t * dy
            if px * px + py * py <= row[5] * row[5] and (best < 0.0 or t < best):
                best = t
        return best
    if form == ELLIPSOID:
        sx, sy, sz = 1.0 / row[3], 1.0 / row[4], 1.0 / row[5]
        ox, oy, oz, dx, dy, dz = ox * sx, oy * sy, oz * sz, dx * sx, dy * sy, dz * sz
        a = dx * dx + dy * dy + dz * dz
        b = ox * dx + oy * dy + oz * dz
        c = ox * ox + oy * oy + oz * oz - 1.0
        discriminant = b * b - a * c
        if discriminant < 0.0:
            return -1.0
        t = (-b - math.sqrt(discriminant)) / a
        return t if t > NEAR_M else -1.0
    enter, leave = NEAR_M, SKY_DEPTH_M
    for o, d, low, high in ((ox, dx, -row[4], row[4]), (oy, dy, -row[5], row[5]), (oz, dz, 0.0, row[3])):
        if abs(d) < 1e-12:
            if o < low or o > high:
                return -1.0
        else:
            t0, t1 = (low - o) / d, (high - o) / d
            enter, leave = max(enter, min(t0, t1)), min(leave, max(t0, t1))
    return enter if NEAR_M < enter <= leave else -1.0


@compiled(fastmath=FAST, error_model="numpy")
def shadow_map(
    forms: np.ndarray, rows: np.ndarray, fixed: np.ndarray, sun: np.ndarray, half: float, out: np.ndarray
) -> None:
    """Write to `out` the light that reaches the ground.

    Obstacles block sunlight; close to an obstacle they hide part of the sky too (contact shadow).

    Args:
        forms: shapes, as in `Primitives`.
        rows: positions and sizes, as in `Primitives`.
        fixed: `(P,)` bool, whether a primitive stands still; others cast no shadow.
        sun: `(3,)` unit direction to the sun.
        half: half the side of the map in metres; its centre is the origin.
        out: `[iy, ix]` `(n, n)` float32, written: share of the light.
    """
    n = out.shape[0]
    cell = 2.0 * half / n
    out[:] = 1.0
    d = np.empty(3)
    for p in range(len(forms)):
        if not fixed[p]:
            continue
        row, form = rows[p], forms[p]
        hx, hy, _, z1 = extents(form, row)
        reach = math.sqrt(hx * hx + hy * hy)
        into_frame(row, sun, d)
        cosine, sine = math.cos(row[6]), math.sin(row[6])
        length = (row[2] + z1) / sun[2]  # length of the shadow along -sun, per unit of the sun's horizontal part
        ex, ey = row[0] - sun[0] * length, row[1] - sun[1] * length
        # The shadow lies along a strip from the primitive away from the sun.
        way_x, way_y = ex - row[0], ey - row[1]
        way = max(math.sqrt(way_x * way_x + way_y * way_y), 1e-9)
        way_x, way_y = way_x / way, way_y / way
        spread = reach + _CONTACT_M + cell
        wide = abs(cosine) * hx + abs(sine) * hy + _CONTACT_M + cell
        high = abs(sine) * hx + abs(cosine) * hy + _CONTACT_M + cell
        x0 = max(int((min(row[0], ex) - wide + half) / cell), 0)
        x1 = min(int((max(row[0], ex) + wide + half) / cell) + 1, n)
        y0 = max(int((min(row[1], ey) - high + half) / cell), 0)
        y1 = min(int((max(row[1], ey) + high + half) / cell) + 1, n)
        for iy in range(y0, y1):
            y = -half + (iy + 0.5) * cell - row[1]
            for ix in range(x0, x1):
                x = -half + (ix + 0.5) * cell - row[0]
                if abs(x * way_y - y * way_x) > spread:
                    continue
                lx, ly = cosine * x + sine * y, cosine * y - sine * x
                if _enter(form, row, lx, ly, -row[2], d[0], d[1], d[2]) > 0.0:
                    out[iy, ix] = min(out[iy, ix], _IN_SHADOW)
                if row[2] < 0.05:
                    qx, qy = max(abs(lx) - hx, 0.0), max(abs(ly) - hy, 0.0)
                    gap = math.sqrt(qx * qx + qy * qy)
                    if form != _BOX:
                        gap = max(math.sqrt(lx * lx + ly * ly) - hx, 0.0)
                    if gap < _CONTACT_M:
                        out[iy, ix] *= 0.62 + 0.38 * gap / _CONTACT_M


def shadow_corners(light: np.ndarray) -> np.ndarray:
    """Return the light of each cell of a `shadow_map` and of its neighbours in x, y and both, as four bytes, uint32.

    So `sunshine` reads everything for a cell from one address.
    """
    level = np.rint(255.0 * np.pad(light, ((0, 1), (0, 1)), "edge")).astype(np.uint32)
    return level[:-1, :-1] | level[:-1, 1:] << 8 | level[1:, :-1] << 16 | level[1:, 1:] << 24


@compiled(**ROWWISE)
def sunshine(corners: np.ndarray, half_m: float, x: np.ndarray, y: np.ndarray, at: np.ndarray, out: np.ndarray) -> None:
    """Write to `out` the light that reaches points on the ground, interpolated between cells of the shadow map.

    Args:
        corners: `(m, m)` uint32 from `shadow_corners`.
        half_m: half the side of the map in metres; its centre is the origin.
        x: `(n,)` float32, x of the points in metres.
        y: `(n,)` float32, y of the points in metres.
        at: `(n,)` uint32, buffer.
        out: `(n,)`, written: share of the light.
    """
    cells = corners.shape[0]
    flat = corners.reshape(-1)
    per_m, middle, last = np.float32(cells / (2.0 * half_m)), np.float32(0.5 * cells - 0.5), np.float32(cells - 1.001)
    for j in range(len(out)):
        ix, iy = np.int32(_cell(x[j], per_m, middle, last)), np.int32(_cell(y[j], per_m, middle, last))
        at[j] = np.uint32(iy * np.int32(cells) + ix)
    for j in range(len(out)):
        at[j] = flat[at[j]]
    for j in range(len(out)):
        gx, gy = _cell(x[j], per_m, middle, last), _cell(y[j], per_m, middle, last)
        fx, fy = gx - np.float32(np.int32(gx)), gy - np.float32(np.int32(gy))
        four = at[j]
        near = _light(four) + fx * (_light(four >> _BYTE) - _light(four))
        far = _light(four >> _TWO_BYTES) + fx * (_light(four >> _THREE_BYTES) - _light(four >> _TWO_BYTES))
        out[j] = (near + fy * (far - near)) * _PER_LEVEL


@compiled(**ROWWISE)
def _cell(point_m: np.float32, per_m: np.float32, middle: np.float32, last: np.float32) -> np.float32:
    """Return the fractional index of a shadow map's cell along one axis."""
    return min(max(point_m * per_m + middle, _ZERO), last)


@compiled(**ROWWISE)
def _light(four: np.uint32) -> np.float32:
    """Return the lowest byte of a number."""
    return np.float32(np.int32(four & _LAST_BYTE))


@compiled(**ROWWISE)
def darken(disc: np.ndarray, x: np.ndarray, y: np.ndarray, lit: np.ndarray) -> None:
    """Darken the ground around the feet of a walking obstacle; `disc` is x, y and radius in metres."""
    dx, dy, per_radius = np.float32(disc[0]), np.float32(disc[1]), np.float32(1.0 / disc[2])
    for j in range(len(lit)):
        gap = np.sqrt((x[j] - dx) * (x[j] - dx) + (y[j] - dy) * (y[j] - dy)) * per_radius
        lit[j] *= min(_SHADE + _LIGHTER * max(gap - _ONE, _ZERO), _ONE)
