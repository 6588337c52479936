"""Numba kernels of the ray caster: ray intersection with a z-buffer, and segment numbers of pixels.

The ray of a pixel is `forward + a left + b up` with `a = tan (1 - 2 (column + .5) / n)` and the same for `b` by row. So
the parameter `t` of a point on the ray is the point's depth along the camera's axis. Each primitive is drawn only into
the screen rectangle of its bounding box.
"""

import math

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.sim.camera.primitives import Form

# Finite arithmetic only: nothing here may produce inf or NaN, and the sky has the depth SKY_DEPTH_M.
FAST = {"contract", "arcp", "afn", "reassoc", "nsz"}
# Options of kernels that are called for each row of pixels. Counting the references to slices takes as long as the
# short loops over them: with it a picture takes 1.2 times as long (1.55 instead of 1.30 ms at 224 px, 0.65 instead of
# 0.52 ms at 128 px). numba has no public option to skip the counting, only `_nrt`. A kernel without it cannot make
# arrays, and its caller must keep alive the arrays that it passes.
ROWWISE = {"fastmath": FAST, "error_model": "numpy", "_nrt": False}
SKY_DEPTH_M = 1e6
NEAR_M = 0.02
SKY, GROUND = -2, -1  # in the index image; primitives count from 0

# Constants in single precision; a Python number in a kernel would be in double precision.
_ZERO, _TINY, LEVEL = np.float32(0.0), np.float32(1e-7), np.float32(1e-5)
_NEAR, _SKY_DEPTH, _NEVER = np.float32(NEAR_M), np.float32(SKY_DEPTH_M), np.float32(1e12)

_VECTOR_PX = 8  # pixels: at least as many as the processor handles with one instruction

FRUSTUM, ELLIPSOID = int(Form.FRUSTUM), int(Form.ELLIPSOID)


@compiled()
def widened(first: int, last: int, size: int) -> tuple[int, int]:
    """Return a span of a row of `size` pixels, widened to a multiple of `_VECTOR_PX` if the row has room.

    The pixels that are left over after a vectorised loop take longer than a few more pixels in the loop.
    """
    length = min((last - first + _VECTOR_PX - 1) // _VECTOR_PX * _VECTOR_PX, size)
    first = min(first, size - length)
    return first, first + length


@compiled()
def extents(form: int, row: np.ndarray) -> tuple[float, float, float, float]:
    """Return the half extents in x and y and the z range of a primitive's bounding box, in its own frame."""
    if form == FRUSTUM:
        r = max(row[4], row[5])
        return r, r, 0.0, row[3]
    if form == ELLIPSOID:
        return row[3], row[4], -row[5], row[5]
    return row[4], row[5], 0.0, row[3]


@compiled()
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
    """Return the pixel rectangle of a primitive: first and last row, first and last column, ends excluded."""
    hx, hy, z0, z1 = extents(form, row)
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
    if row0 >= row1 or column0 >= column1:
        return 0, 0, 0, 0
    return row0, row1, *widened(column0, column1, size)


@compiled()
def into_frame(row: np.ndarray, vector: np.ndarray, out: np.ndarray) -> None:
    """Write to `out` a world vector turned into the primitive's frame."""
    c, s = math.cos(row[6]), math.sin(row[6])
    out[0] = c * vector[0] + s * vector[1]
    out[1] = c * vector[1] - s * vector[0]
    out[2] = vector[2]


@compiled(fastmath=FAST, error_model="numpy")
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
    """Write the depth of every pixel, and its nearest primitive, `GROUND` or `SKY`.

    The inner loops run over a row of pixels, in single precision and without branches, so that the compiler can
    vectorise them.

    Args:
        forms: shapes, as in `Primitives`.
        rows: positions and sizes, as in `Primitives`.
        origin: position of the camera, see `optics.mount`.
        axes: axes of the camera, see `optics.mount`.
        tangents: `(n,)` float32, from `optics.tangents`.
        depth: `(n, n)` float32, written: depth in metres along the camera's axis.
        index: `(n, n)` int32, written: number of the primitive, or `GROUND` or `SKY`.
        rectangles: `(P, 4)` int64, written: first and end row, first and end column in which each primitive is drawn.
    """
    n = depth.shape[0]
    tangent = float(tangents[0]) * n / (n - 1)
    _cast_grounds(origin, axes, tangents, depth, index)
    local = np.empty((4, 3))
    for p in range(len(forms)):
        row = rows[p]
        into_frame(row, origin - row[:3], local[0])
        for k in range(3):
            into_frame(row, axes[k], local[1 + k])
        rectangles[p] = _rectangle(forms[p], row, local[0], local[1], local[2], local[3], tangent, n)
        if forms[p] == ELLIPSOID:  # a unit ball in coordinates scaled by its axes
            local /= row[3:6]
        _cast_primitive(forms[p], row, local, rectangles[p], tangents, depth, index, p)


@compiled(**ROWWISE)
def _cast_grounds(
    origin: np.ndarray, axes: np.ndarray, tangents: np.ndarray, depth: np.ndarray, index: np.ndarray
) -> None:
    for i in range(len(tangents)):
        _cast_ground(origin, axes, tangents[i], tangents, depth[i], index[i])


@compiled(**ROWWISE)
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
    """Draw one primitive; `local` `(4, 3)` is the camera's position and its axes in the primitive's frame."""
    row0, row1, column0, column1 = rectangle
    a, o, f, left, up = tangents[column0:column1], local[0], local[1], local[2], local[3]
    for i in range(row0, row1):
        t, which = depth[i, column0:column1], index[i, column0:column1]
        if form == FRUSTUM:
            _cast_frustum(row, o, f, left, up, tangents[i], a, t, which, p)
        elif form == ELLIPSOID:
            _cast_ball(o, f, left, up, tangents[i], a, t, which, p)
        else:
            _cast_box(row, o, f, left, up, tangents[i], a, t, which, p)


@compiled(**ROWWISE)
def row_directions(
    forward: np.ndarray, left: np.ndarray, up: np.ndarray, b: float
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Return the ray direction in the middle of a row of pixels, `b` up, and its change per unit to the left."""
    return (
        np.float32(forward[0] + b * up[0]),
        np.float32(forward[1] + b * up[1]),
        np.float32(forward[2] + b * up[2]),
        np.float32(left[0]),
        np.float32(left[1]),
        np.float32(left[2]),
    )


@compiled(**ROWWISE)
def _cast_ground(
    origin: np.ndarray, axes: np.ndarray, b: float, a: np.ndarray, depth: np.ndarray, index: np.ndarray
) -> None:
    height, slope = np.float32(origin[2]), np.float32(axes[1, 2])
    start = np.float32(axes[0, 2] + b * axes[2, 2])
    for j in range(len(a)):
        dz = start + a[j] * slope
        down = dz < -LEVEL
        depth[j] = -height / dz if down else _SKY_DEPTH
        index[j] = GROUND if down else SKY


@compiled(**ROWWISE)
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
    above = height - oz if oz > height else _NEVER  # the top disc is visible from above only
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
        cap = above / dz
        px, py = ox + cap * dx, oy + cap * dy
        best = cap if (dz < _ZERO) & (px * px + py * py <= top * top) & (cap < best) & (cap > _ZERO) else best
        hit = best < depth[j]
        depth[j] = best if hit else depth[j]
        index[j] = p if hit else index[j]


@compiled(**ROWWISE)
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


@compiled(**ROWWISE)
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
        # A direction along a face is changed a little: no division by zero, and no visible difference.
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


@compiled(**ROWWISE)
def look_up(numbers: np.ndarray, index: np.ndarray, out: np.ndarray) -> None:
    """Write to `out` `(n, n)` the number of each pixel; `numbers` has those of `SKY`, `GROUND` and each primitive."""
    for i in range(len(index)):
        for j in range(index.shape[1]):
            out[i, j] = numbers[np.uint32(index[i, j] - SKY)]
