"""Ground truth of the simulated world: distances and obstacles along horizontal rays from the camera."""

import math
from typing import NamedTuple

import numpy as np

from zsdist.config import CameraConfig
from zsdist.sim.camera.primitives import ARENA_HALF_M
from zsdist.sim.physics.raycast import ray_distances
from zsdist.sim.scenes.kinds import KINDS, SEGMENT_WALL
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose


class RaysMet(NamedTuple):
    """True hits of R rays.

    Attributes:
        distance_m: `(R,)`, distance from the camera in metres, capped at its range; the range itself means a free ray.
        obstacle: `(R,)` int64, number of the obstacle in the order of `raycast.ray_distances`; negative: none is hit.
        dynamic: `(R,)` bool, whether the obstacle is of a kind that moves.
        segment: `(R,)` uint8, `Kind.segment_id` of the obstacle, `SEGMENT_WALL`, or 0 for a free ray.
    """

    distance_m: np.ndarray
    obstacle: np.ndarray
    dynamic: np.ndarray
    segment: np.ndarray


def rays_met(
    scene: Scene, pose: Pose, camera: CameraConfig, angles_rad: np.ndarray, people: np.ndarray | None = None
) -> RaysMet:
    """Return the distance and the obstacle of horizontal rays from the camera.

    Args:
        scene: scene in the arena.
        pose: pose of the car.
        camera: mount and range of the camera.
        angles_rad: `(R,)` angles of the rays from the camera's axis, left positive.
        people: `(W, 2)` positions of the walking obstacles; None: at their start.
    """
    x_m = pose.x_m + camera.forward_m * math.cos(pose.heading_rad)
    y_m = pose.y_m + camera.forward_m * math.sin(pose.heading_rad)
    headings = pose.heading_rad + angles_rad
    distance_m, obstacle = ray_distances(
        scene.circles(people), scene.boxes(), ARENA_HALF_M, x_m, y_m, headings, camera.range_m
    )
    kinds = [KINDS[kind] for kind in _kinds_in_order_of_rays(scene)]
    moves = np.array([kind.dynamic for kind in kinds] + [False])
    segments = np.array([kind.segment_id for kind in kinds] + [SEGMENT_WALL, 0], np.uint8)  # -2 and -1 last
    return RaysMet(distance_m, obstacle, moves[np.maximum(obstacle, -1)], segments[obstacle])


def _kinds_in_order_of_rays(scene: Scene) -> list[str]:
    """Return the kinds of the scene's obstacles in the order of `ray_distances`: round ones, then boxes."""
    round_ones = [obstacle.kind for obstacle in scene.obstacles if obstacle.size_m is None]
    return round_ones + [obstacle.kind for obstacle in scene.obstacles if obstacle.size_m is not None]
