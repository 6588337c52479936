"""Collision tests of the car's box with the true obstacle shapes: contact, clearance and rasterisation.

Circles are rows `x, y, radius`; boxes are rows `x, y, length, width, heading_rad` (length along the heading).
"""

import math

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.planning.footprint import CAR_LENGTH_M, CAR_WIDTH_M
from zsdist.planning.grid import Grid
from zsdist.types import Pose

NO_CIRCLES = np.empty((0, 3))
NO_BOXES = np.empty((0, 5))


def touching(
    pose: Pose,
    circles: np.ndarray,
    boxes: np.ndarray,
    length_m: float = CAR_LENGTH_M,
    width_m: float = CAR_WIDTH_M,
    arena_m: float = math.inf,
) -> bool:
    """Return whether the oriented box at `pose` touches an obstacle or a wall; arguments as in `clearance_m`."""
    return clearance_m(pose, circles, boxes, length_m, width_m, arena_m) <= 0.0


def clearance_m(
    pose: Pose,
    circles: np.ndarray,
    boxes: np.ndarray,
    length_m: float = CAR_LENGTH_M,
    width_m: float = CAR_WIDTH_M,
    arena_m: float = math.inf,
) -> float:
    """Return the distance in metres from the oriented box at `pose` to the nearest surface.

    Args:
        pose: pose of the box.
        circles: `(N, 3)` float64, round obstacles.
        boxes: `(M, 5)` float64, oriented boxes.
        length_m: length of the box along its heading; 0 with `width_m` 0 for a point.
        width_m: width of the box.
        arena_m: side of the walled arena around the origin; infinite: no walls.

    Returns:
        The distance; 0 if the box touches or overlaps an obstacle or wall, infinite if there is none.
    """
    return box_clearance(pose[0], pose[1], pose[2], length_m / 2, width_m / 2, circles, boxes, arena_m / 2)


@compiled()
def box_clearance(
    x: float,
    y: float,
    heading: float,
    half_l: float,
    half_w: float,
    circles: np.ndarray,
    boxes: np.ndarray,
    wall: float,
) -> float:
    """Return `clearance_m` from half the box's sides and half the arena's side; compiled."""
    cos, sin = math.cos(heading), math.sin(heading)
    nearest = min(
        wall - abs(x) - abs(cos) * half_l - abs(sin) * half_w, wall - abs(y) - abs(sin) * half_l - abs(cos) * half_w
    )
    for i in range(circles.shape[0]):
        along = (circles[i, 0] - x) * cos + (circles[i, 1] - y) * sin
        across = (circles[i, 1] - y) * cos - (circles[i, 0] - x) * sin
        dx = max(abs(along) - half_l, 0.0)
        dy = max(abs(across) - half_w, 0.0)
        nearest = min(nearest, math.sqrt(dx * dx + dy * dy) - circles[i, 2])
    reach = math.sqrt(half_l * half_l + half_w * half_w)
    for i in range(boxes.shape[0]):
        dx, dy = boxes[i, 0] - x, boxes[i, 1] - y
        half_l2, half_w2 = boxes[i, 2] / 2, boxes[i, 3] / 2
        far = math.sqrt(dx * dx + dy * dy) - reach - math.sqrt(half_l2 * half_l2 + half_w2 * half_w2)
        if far < nearest:
            turn = boxes[i, 4] - heading
            along, across = dx * cos + dy * sin, dy * cos - dx * sin
            gap = _box_gap(along, across, math.cos(turn), math.sin(turn), half_l, half_w, half_l2, half_w2)
            nearest = min(nearest, gap)
    return max(nearest, 0.0)


@compiled()
def _box_gap(
    cx: float, cy: float, cos: float, sin: float, half_l: float, half_w: float, half_l2: float, half_w2: float
) -> float:
    """Return the distance between a box along the axes at the origin and one at `(cx, cy)` turned by (cos, sin).

    They overlap unless one of their four axes separates them. If they do not overlap, the nearest points include a
    corner of one of them.
    """
    bx, by = -(cx * cos + cy * sin), cx * sin - cy * cos  # the first box's centre in the second's frame
    apart = (
        abs(cx) > half_l + abs(cos) * half_l2 + abs(sin) * half_w2
        or abs(cy) > half_w + abs(sin) * half_l2 + abs(cos) * half_w2
        or abs(bx) > half_l2 + abs(cos) * half_l + abs(sin) * half_w
        or abs(by) > half_w2 + abs(sin) * half_l + abs(cos) * half_w
    )
    if not apart:
        return 0.0
    least = math.inf
    for u in (-1.0, 1.0):
        for v in (-1.0, 1.0):
            px, py = cx + u * half_l2 * cos - v * half_w2 * sin, cy + u * half_l2 * sin + v * half_w2 * cos
            dx, dy = max(abs(px) - half_l, 0.0), max(abs(py) - half_w, 0.0)
            least = min(least, dx * dx + dy * dy)
            qx, qy = bx + u * half_l * cos + v * half_w * sin, by - u * half_l * sin + v * half_w * cos
            dx, dy = max(abs(qx) - half_l2, 0.0), max(abs(qy) - half_w2, 0.0)
            least = min(least, dx * dx + dy * dy)
    return math.sqrt(least)


def rasterise(circles: np.ndarray, boxes: np.ndarray, grid: Grid) -> np.ndarray:
    """Return the fine cells that any shape touches, `[iy, ix]` `(fine_size, fine_size)` bool.

    No part of a shape lies outside the marked cells, however thin it is.
    """
    return _rasterise(circles, boxes, grid.fine_size, grid.fine_m)


@compiled()
def _rasterise(circles: np.ndarray, boxes: np.ndarray, size: int, fine_m: float) -> np.ndarray:
    occupied = np.zeros((size, size), dtype=np.bool_)
    origin, half = -size * fine_m / 2, fine_m / 2
    for i in range(circles.shape[0]):
        x, y, r = circles[i, 0] - origin, circles[i, 1] - origin, circles[i, 2]
        for fy in range(max(int((y - r) / fine_m), 0), min(int((y + r) / fine_m) + 1, size)):
            for fx in range(max(int((x - r) / fine_m), 0), min(int((x + r) / fine_m) + 1, size)):
                dx = max(abs((fx + 0.5) * fine_m - x) - half, 0.0)
                dy = max(abs((fy + 0.5) * fine_m - y) - half, 0.0)
                if dx * dx + dy * dy <= r * r:
                    occupied[fy, fx] = True
    for i in range(boxes.shape[0]):
        x, y, half_l, half_w = boxes[i, 0] - origin, boxes[i, 1] - origin, boxes[i, 2] / 2, boxes[i, 3] / 2
        cos, sin = math.cos(boxes[i, 4]), math.sin(boxes[i, 4])
        wide, high = abs(cos) * half_l + abs(sin) * half_w, abs(sin) * half_l + abs(cos) * half_w
        grow = half * (abs(cos) + abs(sin))  # half a fine cell's extent along the box's axes
        for fy in range(max(int((y - high) / fine_m), 0), min(int((y + high) / fine_m) + 1, size)):
            for fx in range(max(int((x - wide) / fine_m), 0), min(int((x + wide) / fine_m) + 1, size)):
                dx, dy = (fx + 0.5) * fine_m - x, (fy + 0.5) * fine_m - y
                if abs(dx * cos + dy * sin) <= half_l + grow and abs(dy * cos - dx * sin) <= half_w + grow:
                    occupied[fy, fx] = True
    return occupied
