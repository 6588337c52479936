"""Exact distances along horizontal rays to a scene's circles and boxes and to the arena's walls."""

import math

import numpy as np

from zsdist.common.compiled import compiled

HIT_NOTHING = -1
HIT_WALL = -2


def ray_distances(
    circles: np.ndarray,
    boxes: np.ndarray,
    arena_half_m: float,
    x_m: float,
    y_m: float,
    angles_rad: np.ndarray,
    max_m: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance along each ray from a point to the nearest obstacle or wall, in the plane.

    Args:
        circles: `(N, 3)` x, y, radius in metres.
        boxes: `(M, 5)` x, y, length, width in metres and heading in radians.
        arena_half_m: half the arena's side: the walls' distance from the origin in x and y; infinity: no walls.
        x_m: x of the point.
        y_m: y of the point.
        angles_rad: `(R,)`, directions of the rays, counter-clockwise from east.
        max_m: greatest length of a ray.

    Returns:
        `(R,)` float64 distances, `max_m` if nothing nearer is hit, 0 inside an obstacle; and `(R,)` int64 hits: the
        circle's index, N plus the box's index, `HIT_WALL` or `HIT_NOTHING`.
    """
    return _ray_distances(
        np.ascontiguousarray(circles, np.float64).reshape(-1, 3),
        np.ascontiguousarray(boxes, np.float64).reshape(-1, 5),
        float(arena_half_m),
        float(x_m),
        float(y_m),
        np.ascontiguousarray(angles_rad, np.float64),
        float(max_m),
    )


@compiled()
def _ray_distances(
    circles: np.ndarray, boxes: np.ndarray, half: float, x: float, y: float, angles: np.ndarray, max_m: float
) -> tuple[np.ndarray, np.ndarray]:
    distances = np.full(len(angles), max_m)
    hits = np.full(len(angles), HIT_NOTHING)
    for ray in range(len(angles)):
        dx, dy = math.cos(angles[ray]), math.sin(angles[ray])
        best, hit = max_m, HIT_NOTHING
        for along, component in ((x, dx), (y, dy)):
            if component != 0.0:
                t = (math.copysign(half, component) - along) / component
                if t < best:
                    best, hit = max(t, 0.0), HIT_WALL
        for k in range(len(circles)):
            ox, oy, radius = x - circles[k, 0], y - circles[k, 1], circles[k, 2]
            b, c = ox * dx + oy * dy, ox * ox + oy * oy - radius * radius
            discriminant = b * b - c
            if discriminant < 0.0:
                continue
            t = -b - math.sqrt(discriminant)
            if c <= 0.0:
                t = 0.0  # the point is inside
            if 0.0 <= t < best:
                best, hit = t, k
        for k in range(len(boxes)):
            cos, sin = math.cos(boxes[k, 4]), math.sin(boxes[k, 4])
            ox, oy = x - boxes[k, 0], y - boxes[k, 1]
            enter, leave = 0.0, best
            for o, d, extent in (
                (ox * cos + oy * sin, dx * cos + dy * sin, boxes[k, 2] / 2),
                (oy * cos - ox * sin, dy * cos - dx * sin, boxes[k, 3] / 2),
            ):
                if d == 0.0:
                    if abs(o) > extent:
                        leave = -1.0
                else:
                    near, far = (-extent - o) / d, (extent - o) / d
                    enter = max(enter, min(near, far))
                    leave = min(leave, max(near, far))
            if enter <= leave and enter < best:
                best, hit = enter, len(circles) + k
        distances[ray] = best
        hits[ray] = hit
    return distances, hits
