"""Numba kernels of the ray caster: intersection with a z-buffer, shading, and the ground's shadow map.

A pixel's ray is `forward + a left + b up` with `a = tan (1 - 2 (column + .5) / n)` and `b` likewise by row, so the
parameter `t` of a point on it is its depth along the camera's axis. Each primitive is drawn into the screen rectangle
of its bounding box only.
"""

import math

import numpy as np
from numba import njit

from zsdist.sim.camera.primitives import Form

# Finite arithmetic only; nothing here may produce inf or NaN, sky has depth SKY_DEPTH_M.
FAST = {"contract", "arcp", "afn", "reassoc", "nsz"}
# Of what is called for each row of pixels. To count the references to slices would take as long as the short loops
# over them, so that is left out; such a kernel cannot make arrays, and whoever calls it holds those that it is given.
ROWWISE = {"cache": True, "fastmath": FAST, "error_model": "numpy", "_nrt": False}
SKY_DEPTH_M = 1e6
NEAR_M = 0.02
SKY, GROUND = -2, -1  # in the index image; primitives count from 0

# single precision, which a plain number in a kernel would not be
_ZERO, _TINY, _LEVEL = np.float32(0.0), np.float32(1e-7), np.float32(1e-5)
_NEAR, _SKY_DEPTH, _NEVER = np.float32(NEAR_M), np.float32(SKY_DEPTH_M), np.float32(1e12)

_IN_SHADOW, _CONTACT_M = np.float32(0.55), 0.5

_FRUSTUM, _ELLIPSOID, _BOX = int(Form.FRUSTUM), int(Form.ELLIPSOID), int(Form.BOX)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _enter(form: int, row: np.ndarray, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> float:
    """Depth at which a ray in the primitive's own frame (origin at its row's place) first meets it; -1: never."""
    if form == _FRUSTUM:
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
    if form == _ELLIPSOID:
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


@njit(cache=True)
def _extents(form: int, row: np.ndarray) -> tuple[float, float, float, float]:
    """Half extents in x and y and the z range of a primitive's bounding box, in its own frame."""
    if form == _FRUSTUM:
        r = max(row[4], row[5])
        return r, r, 0.0, row[3]
    if form == _ELLIPSOID:
        return row[3], row[4], -row[5], row[5]
    return row[4], row[5], 0.0, row[3]


@njit(cache=True)
def _rectangle(
    form: int,
    row: np.ndarray,
    o: np.ndarray,
    f: np.ndarray,
    left: np.ndarray,
    up: np.ndarray,
    tangent: float,
    size: int,
) -> tuple[int, int, int, int]:
    """Pixel rectangle (first and last row, first and last column, ends excluded) that holds the primitive's image."""
    hx, hy, z0, z1 = _extents(form, row)
    corners = np.empty((8, 3))
    for i in range(8):
        x = (hx if i & 1 else -hx) - o[0]
        y = (hy if i & 2 else -hy) - o[1]
        z = (z1 if i & 4 else z0) - o[2]
        corners[i, 0] = f[0] * x + f[1] * y + f[2] * z
        corners[i, 1] = left[0] * x + left[1] * y + left[2] * z
        corners[i, 2] = up[0] * x + up[1] * y + up[2] * z
    a0, a1, b0, b1 = 1e9, -1e9, 1e9, -1e9
    for i in range(8):
        for bit in (1, 2, 4):
            j = i | bit
            if j == i:
                continue
            ti, tj = corners[i, 0], corners[j, 0]
            if ti < NEAR_M and tj < NEAR_M:
                continue
            for end in range(2):
                t, share = (ti, 0.0) if end == 0 else (tj, 1.0)
                if t < NEAR_M:
                    t, share = NEAR_M, (NEAR_M - ti) / (tj - ti)
                a = (corners[i, 1] + share * (corners[j, 1] - corners[i, 1])) / t
                b = (corners[i, 2] + share * (corners[j, 2] - corners[i, 2])) / t
                a0, a1, b0, b1 = min(a0, a), max(a1, a), min(b0, b), max(b1, b)
    if a0 > a1:
        return 0, 0, 0, 0
    scale = size / (2.0 * tangent)
    limit = tangent * 1.01
    a0, a1 = max(a0, -limit), min(a1, limit)
    b0, b1 = max(b0, -limit), min(b1, limit)
    column0 = max(math.floor(size / 2 - a1 * scale - 0.5), 0)
    column1 = min(math.ceil(size / 2 - a0 * scale + 0.5), size)
    row0 = max(math.floor(size / 2 - b1 * scale - 0.5), 0)
    row1 = min(math.ceil(size / 2 - b0 * scale + 0.5), size)
    return row0, row1, column0, column1


@njit(cache=True)
def _local(row: np.ndarray, vector: np.ndarray, out: np.ndarray) -> None:
    """A world vector turned into the primitive's frame."""
    c, s = math.cos(row[6]), math.sin(row[6])
    out[0] = c * vector[0] + s * vector[1]
    out[1] = c * vector[1] - s * vector[0]
    out[2] = vector[2]


@njit(cache=True, fastmath=FAST, error_model="numpy")
def cast(
    forms: np.ndarray,
    rows: np.ndarray,
    origin: np.ndarray,
    axes: np.ndarray,
    tangents: np.ndarray,
    depth: np.ndarray,
    index: np.ndarray,
    rectangles: np.ndarray,
) -> None:
    """Fill `depth` `(n, n)` and `index` `(n, n)` with the nearest primitive, `GROUND` or `SKY` of every pixel.

    The inner loops run over a row of pixels, in single precision and without branches, so that the compiler can do
    many pixels at once.

    Args:
        forms: see `Primitives`.
        rows: see `Primitives`.
        origin: of the camera, see `optics.mount`.
        axes: of the camera, see `optics.mount`.
        tangents: `(n,)` float32, from `optics.tangents`.
        depth: `(n, n)` float32 metres along the axis, written.
        index: `(n, n)` int32, written.
        rectangles: `(P, 4)` int64, written: rows and columns within which each primitive's picture lies.
    """
    n = depth.shape[0]
    tangent = float(tangents[0]) * n / (n - 1)
    _cast_grounds(origin, axes, tangents, depth, index)
    local = np.empty((4, 3))
    for p in range(len(forms)):
        row = rows[p]
        _local(row, origin - row[:3], local[0])
        for k in range(3):
            _local(row, axes[k], local[1 + k])
        rectangles[p] = _rectangle(forms[p], row, local[0], local[1], local[2], local[3], tangent, n)
        if forms[p] == _ELLIPSOID:  # a unit ball, once space is shrunk to its axes
            local /= row[3:6]
        _cast_primitive(forms[p], row, local, rectangles[p], tangents, depth, index, p)


@njit(**ROWWISE)
def _cast_grounds(
    origin: np.ndarray, axes: np.ndarray, tangents: np.ndarray, depth: np.ndarray, index: np.ndarray
) -> None:
    for i in range(len(tangents)):
        _cast_ground(origin, axes, tangents[i], tangents, depth[i], index[i])


@njit(**ROWWISE)
def _cast_primitive(
    form: int,
    row: np.ndarray,
    local: np.ndarray,
    rectangle: np.ndarray,
    tangents: np.ndarray,
    depth: np.ndarray,
    index: np.ndarray,
    p: int,
) -> None:
    """Casts one primitive; `local` `(4, 3)` is the camera's place and its axes in the primitive's frame."""
    row0, row1, column0, column1 = rectangle
    a, o, f, left, up = tangents[column0:column1], local[0], local[1], local[2], local[3]
    for i in range(row0, row1):
        t, which = depth[i, column0:column1], index[i, column0:column1]
        if form == _FRUSTUM:
            _cast_frustum(row, o, f, left, up, tangents[i], a, t, which, p)
        elif form == _ELLIPSOID:
            _cast_ball(o, f, left, up, tangents[i], a, t, which, p)
        else:
            _cast_box(row, o, f, left, up, tangents[i], a, t, which, p)


@njit(**ROWWISE)
def row_directions(
    forward: np.ndarray, left: np.ndarray, up: np.ndarray, b: float
) -> tuple[float, float, float, float, float, float]:
    """Direction of the ray in the middle of a row of pixels, `b` up, and what it gains per unit to the left."""
    return (
        np.float32(forward[0] + b * up[0]),
        np.float32(forward[1] + b * up[1]),
        np.float32(forward[2] + b * up[2]),
        np.float32(left[0]),
        np.float32(left[1]),
        np.float32(left[2]),
    )


@njit(**ROWWISE)
def _cast_ground(
    origin: np.ndarray, axes: np.ndarray, b: float, a: np.ndarray, depth: np.ndarray, index: np.ndarray
) -> None:
    height, slope = np.float32(origin[2]), np.float32(axes[1, 2])
    start = np.float32(axes[0, 2] + b * axes[2, 2])
    for j in range(len(a)):
        dz = start + a[j] * slope
        down = dz < -_LEVEL
        depth[j] = -height / dz if down else _SKY_DEPTH
        index[j] = GROUND if down else SKY


@njit(**ROWWISE)
def _cast_frustum(
    row: np.ndarray,
    o: np.ndarray,
    f: np.ndarray,
    left: np.ndarray,
    up: np.ndarray,
    b: float,
    a: np.ndarray,
    depth: np.ndarray,
    index: np.ndarray,
    p: int,
) -> None:
    height, bottom, top = np.float32(row[3]), np.float32(row[4]), np.float32(row[5])
    k = (top - bottom) / height
    ox, oy, oz = np.float32(o[0]), np.float32(o[1]), np.float32(o[2])
    bx, by, bz, lx, ly, lz = row_directions(f, left, up, b)
    at = bottom + k * oz
    c = ox * ox + oy * oy - at * at
    above = height - oz if oz > height else _NEVER  # the lid is seen from above only
    for j in range(len(a)):
        dx, dy, dz = bx + a[j] * lx, by + a[j] * ly, bz + a[j] * lz
        square = dx * dx + dy * dy - k * k * dz * dz
        half = ox * dx + oy * dy - k * dz * at
        discriminant = half * half - square * c
        root = np.sqrt(max(discriminant, _ZERO))
        t0, t1 = (-half - root) / square, (-half + root) / square
        near, far = min(t0, t1), max(t0, t1)
        z_near, z_far = oz + near * dz, oz + far * dz
        best = far if (far > _NEAR) & (z_far >= _ZERO) & (z_far <= height) else _SKY_DEPTH
        best = near if (near > _NEAR) & (z_near >= _ZERO) & (z_near <= height) else best
        best = best if discriminant >= _ZERO else _SKY_DEPTH
        lid = above / dz
        px, py = ox + lid * dx, oy + lid * dy
        best = lid if (dz < _ZERO) & (px * px + py * py <= top * top) & (lid < best) & (lid > _ZERO) else best
        hit = best < depth[j]
        depth[j] = best if hit else depth[j]
        index[j] = p if hit else index[j]


@njit(**ROWWISE)
def _cast_ball(
    o: np.ndarray,
    f: np.ndarray,
    left: np.ndarray,
    up: np.ndarray,
    b: float,
    a: np.ndarray,
    depth: np.ndarray,
    index: np.ndarray,
    p: int,
) -> None:
    ox, oy, oz = np.float32(o[0]), np.float32(o[1]), np.float32(o[2])
    bx, by, bz, lx, ly, lz = row_directions(f, left, up, b)
    c = np.float32(o[0] * o[0] + o[1] * o[1] + o[2] * o[2] - 1.0)
    for j in range(len(a)):
        dx, dy, dz = bx + a[j] * lx, by + a[j] * ly, bz + a[j] * lz
        square = dx * dx + dy * dy + dz * dz
        half = ox * dx + oy * dy + oz * dz
        discriminant = half * half - square * c
        t = (-half - np.sqrt(max(discriminant, _ZERO))) / square
        hit = (discriminant >= _ZERO) & (t > _NEAR) & (t < depth[j])
        depth[j] = t if hit else depth[j]
        index[j] = p if hit else index[j]


@njit(**ROWWISE)
def _cast_box(
    row: np.ndarray,
    o: np.ndarray,
    f: np.ndarray,
    left: np.ndarray,
    up: np.ndarray,
    b: float,
    a: np.ndarray,
    depth: np.ndarray,
    index: np.ndarray,
    p: int,
) -> None:
    height, length, width = np.float32(row[3]), np.float32(row[4]), np.float32(row[5])
    ox, oy, oz = np.float32(o[0]), np.float32(o[1]), np.float32(o[2])
    bx, by, bz, lx, ly, lz = row_directions(f, left, up, b)
    for j in range(len(a)):
        dx, dy, dz = bx + a[j] * lx, by + a[j] * ly, bz + a[j] * lz
        # A direction along a face is bent a little: no division by zero, and no pixel sees the difference.
        dx = dx if abs(dx) > _TINY else _TINY
        dy = dy if abs(dy) > _TINY else _TINY
        dz = dz if abs(dz) > _TINY else _TINY
        x0, x1 = (-length - ox) / dx, (length - ox) / dx
        y0, y1 = (-width - oy) / dy, (width - oy) / dy
        z0, z1 = -oz / dz, (height - oz) / dz
        enter = max(max(min(x0, x1), min(y0, y1)), min(z0, z1))
        leave = min(min(max(x0, x1), max(y0, y1)), max(z0, z1))
        hit = (enter > _NEAR) & (enter <= leave) & (enter < depth[j])
        depth[j] = enter if hit else depth[j]
        index[j] = p if hit else index[j]


@njit(**ROWWISE)
def look_up(numbers: np.ndarray, index: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` `(n, n)` with the number of what each pixel shows: those of `SKY`, `GROUND` and each primitive."""
    for i in range(len(index)):
        for j in range(index.shape[1]):
            out[i, j] = numbers[np.uint32(index[i, j] - SKY)]


@njit(cache=True, fastmath=FAST, error_model="numpy")
def shadow_map(
    forms: np.ndarray, rows: np.ndarray, fixed: np.ndarray, sun: np.ndarray, half: float, out: np.ndarray
) -> None:
    """How much light reaches the ground, `out` `(n, n)` `[iy, ix]` float32 over plus and minus `half` metres.

    Sunlight is blocked by what stands in its way; close to an obstacle the sky is hidden too (contact shadow).
    `fixed` `(P,)` bool leaves out what moves.
    """
    n = out.shape[0]
    cell = 2.0 * half / n
    out[:] = 1.0
    d = np.empty(3)
    for p in range(len(forms)):
        if not fixed[p]:
            continue
        row, form = rows[p], forms[p]
        hx, hy, _, z1 = _extents(form, row)
        reach = math.sqrt(hx * hx + hy * hy)
        _local(row, sun, d)
        cosine, sine = math.cos(row[6]), math.sin(row[6])
        length = (row[2] + z1) / sun[2]  # of the shadow along -sun, per unit of sun's horizontal part
        ex, ey = row[0] - sun[0] * length, row[1] - sun[1] * length
        # the shadow lies along a strip from the primitive's place away from the sun
        way_x, way_y = ex - row[0], ey - row[1]
        way = max(math.sqrt(way_x * way_x + way_y * way_y), 1e-9)
        way_x, way_y = way_x / way, way_y / way
        spread = reach + _CONTACT_M + cell
        x0 = max(int((min(row[0], ex) - spread + half) / cell), 0)
        x1 = min(int((max(row[0], ex) + spread + half) / cell) + 1, n)
        y0 = max(int((min(row[1], ey) - spread + half) / cell), 0)
        y1 = min(int((max(row[1], ey) + spread + half) / cell) + 1, n)
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
