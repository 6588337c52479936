"""Position and axes of the camera, and the directions of its pixels."""

import math

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.types import Pose


def mount(
    pose: Pose, forward_m: float, height_m: float, roll_rad: float = 0.0, pitch_rad: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the camera's position and axes for a pose of the car.

    The camera is fixed to the body, `forward_m` ahead of the car's centre and `height_m` above the ground. The body's
    rotation is heading about z, then pitch about its left axis (positive: nose down), then roll about its forward
    axis (positive: right side down), the order and signs of PyBullet's Euler angles.

    Returns:
        `(3,)` position in metres, and `(3, 3)` axes as unit rows: forward, left and up in world coordinates.
    """
    return _mount(float(pose.x_m), float(pose.y_m), float(pose.heading_rad), forward_m, height_m, roll_rad, pitch_rad)


@compiled()
def _mount(
    x_m: float, y_m: float, heading: float, forward_m: float, height_m: float, roll: float, pitch: float
) -> tuple[np.ndarray, np.ndarray]:
    cy, sy = math.cos(heading), math.sin(heading)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cr, sr = math.cos(roll), math.sin(roll)
    axes = np.array(
        [
            [cy * cp, sy * cp, -sp],
            [cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr],
            [cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr],
        ]
    )
    position = np.array([x_m, y_m, 0.0]) + forward_m * axes[0] + height_m * axes[2]
    return position, axes


def tangents(size_px: int, field_of_view_rad: float) -> np.ndarray:
    """Return the tangents of the angles from the axis to each column (left positive) or each row (up positive).

    Returns:
        `(size_px,)` float32, in descending order.
    """
    half = math.tan(field_of_view_rad / 2)
    return (half * (1 - 2 * (np.arange(size_px) + 0.5) / size_px)).astype(np.float32)
