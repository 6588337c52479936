"""Views of drivers: made from the camera's image by the visual-act model, or from the truth."""

import math

import numpy as np

from zsdist.config import CameraConfig
from zsdist.evaluation.drivers import Observed, See, ViewPredictor
from zsdist.sim.ground_truth import rays_met
from zsdist.sim.physics.raycast import ray_distances
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose, View
from zsdist.vision.labels import nearest, openness, progress, reward_label
from zsdist.vision.rays import RAYS, ray_angles_rad

TRUE_ANGLES_RAD = np.linspace(math.pi / 4, -math.pi / 4, 91)  # rays of the true distances: 90 degrees, leftmost first
TRUE_EDGES_M = np.linspace(0.05, 5.0, 100, dtype=np.float32)  # bins of true distances, finer than the map's cells


def by_camera(visual_act: ViewPredictor) -> See:
    """Return a function that makes the visual-act model's view of the observed image."""

    def see(observed: Observed) -> View:
        assert observed.image is not None, "a driver with a camera is shown pictures"
        bearing_rad, distance_m = observed.pose.towards(*observed.goal)
        (view,) = visual_act(observed.image[None], np.array([bearing_rad]), np.array([distance_m]))
        return view

    return see


def by_truth(observed: Observed) -> View:
    """Return the view of a faultless model: the true distances in view, and the advice that follows from them."""
    assert observed.truth is not None, "a driver of true distances is shown them"
    return observed.truth


def true_view(scene: Scene, pose: Pose, camera: CameraConfig, arena_m: float, people: np.ndarray | None) -> View:
    """Return the view of a faultless model: each ray's distribution is certain, and the advice is the true label.

    Args:
        scene: scene with the obstacles of the arena.
        pose: pose of the car.
        camera: mount and range of the camera.
        arena_m: side of the walled arena.
        people: `(W, 2)` metres, positions of the walking obstacles; None: where they start.
    """
    distances_m, _ = ray_distances(
        scene.circles(people),
        scene.boxes(),
        arena_m / 2,
        pose.x_m + camera.forward_m * math.cos(pose.heading_rad),
        pose.y_m + camera.forward_m * math.sin(pose.heading_rad),
        pose.heading_rad + TRUE_ANGLES_RAD,
        camera.range_m,
    )
    angles_rad = ray_angles_rad(RAYS, math.radians(camera.field_of_view_deg))
    met = rays_met(scene, pose, camera, angles_rad, people)
    clearance_m, moves = nearest(met.distance_m, met.dynamic, angles_rad)
    dynamic = moves.astype(np.float32)
    bearing, goal_m = (np.asarray(value, np.float32) for value in pose.towards(*scene.goal))
    advice: np.ndarray = reward_label(openness(clearance_m, dynamic, goal_m), progress(bearing, goal_m))
    return View(advice.astype(np.float32), clearance_m, dynamic, certain(distances_m), TRUE_ANGLES_RAD, TRUE_EDGES_M)


def certain(distances_m: np.ndarray) -> np.ndarray:
    """Return distances `(R,)` as distributions `(R, K)` over the bins of `TRUE_EDGES_M`, each certain."""
    bins = np.searchsorted(TRUE_EDGES_M, distances_m, side="right") - 1
    bins = np.where(distances_m >= TRUE_EDGES_M[-1], len(TRUE_EDGES_M) - 1, np.maximum(bins, 0))
    return np.eye(len(TRUE_EDGES_M), dtype=np.float32)[bins]
