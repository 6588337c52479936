"""Ground truth of the simulated world: what horizontal rays from the camera meet."""

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
    """True meetings of R rays.

    Attributes:
        distance_m: `(R,)` from the camera, capped at its range, which stands for "free".
        obstacle: `(R,)` int64, number of the obstacle that is met in the order of `raycast.ray_distances`, negative
            where it is none.
        dynamic: `(R,)` bool, whether what is met is of a kind that moves.
        segment: `(R,)` uint8, what is met: `Kind.segment_id`, `SEGMENT_WALL`, or 0 where the ray is free.
    """

    distance_m: np.ndarray
    obstacle: np.ndarray
    dynamic: np.ndarray
    segment: np.ndarray


def rays_met(
    scene: Scene, pose: Pose, camera: CameraConfig, angles_rad: np.ndarray, people: np.ndarray | None = None
) -> RaysMet:
    """Return how far horizontal rays from the camera go, and what they meet.

    Args:
        scene: what stands in the arena.
        pose: of the car.
        camera: mount and range.
        angles_rad: `(R,)` of the rays from the camera's axis, left positive.
        people: `(W, 2)` positions of the walking obstacles; None: where they start.
    """
    x_m = pose.x_m + camera.forward_m * math.cos(pose.heading_rad)
    y_m = pose.y_m + camera.forward_m * math.sin(pose.heading_rad)
    headings = pose.heading_rad + angles_rad
    distance_m, obstacle = ray_distances(
        scene.circles(people), scene.boxes(), ARENA_HALF_M, x_m, y_m, headings, camera.range_m
    )
    kinds = [KINDS[kind] for kind in _kinds_in_order_of_rays(scene)]
    moves = np.array([kind.dynamic for kind in kinds] + [False])
    segments = np.array([kind.segment_id for kind in kinds] + [SEGMENT_WALL, 0], np.uint8)  # of -2 and -1 last
    return RaysMet(distance_m, obstacle, moves[np.maximum(obstacle, -1)], segments[obstacle])


def _kinds_in_order_of_rays(scene: Scene) -> list[str]:
    """Kinds in the order of `ray_distances`: round ones, then boxes."""
    round_ones = [obstacle.kind for obstacle in scene.obstacles if obstacle.size_m is None]
    return round_ones + [obstacle.kind for obstacle in scene.obstacles if obstacle.size_m is not None]
