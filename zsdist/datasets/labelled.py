"""Labelled pictures from random poses in random scenes, for training and testing the visual-act model."""

import contextlib
import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from zsdist.common import random_streams
from zsdist.config import CameraConfig
from zsdist.datasets.degradation import degrade
from zsdist.datasets.sampling import drawn_scenes, free_pose, people_on_paths, varied_camera
from zsdist.sim.camera import make_camera
from zsdist.sim.ground_truth import rays_met
from zsdist.sim.scenes.manifest import Split
from zsdist.sim.scenes.scene import Obstacle, Scene
from zsdist.types import Pose
from zsdist.vision.labels import nearest
from zsdist.vision.rays import RAYS, ray_angles_rad

_PYBULLET_SHARE = 0.12  # share of training scenes drawn by PyBullet, four times as slow and without textures
_TILT_JITTER_RAD = 0.05
_FRESH_POSES = 16  # pictures of a fresh scene: making a scene takes as long as drawing several pictures of it
_DISGUISED_SHARE = 0.2  # share of the fresh scenes in any colours whose obstacles have those of the ground
_ANY_HEIGHT_SHARE = 0.5  # share of the fresh scenes in which boxes are as low or high as `_BOX_HEIGHT_M`
_BOX_HEIGHT_M = (0.5, 2.6)


@dataclass(frozen=True)
class LabelledView:
    """Picture and its ground truth, for R rays and the directions forward, left, right.

    Attributes:
        image: `(size_px, size_px, 3)` uint8.
        ray_clearance_m: `(R,)` float32, horizontal distance from the camera along each ray, leftmost first, capped at
            the camera's range, which stands for "free".
        ray_dynamic: `(R,)` bool, whether the ray meets an obstacle of a kind that moves.
        ray_segment: `(R,)` uint8, segment that the ray meets: `Kind.segment_id`, `SEGMENT_WALL`, or 0 if it is free.
        clearance_m: `(3,)` float32, shortest distance along the rays of each direction.
        dynamic: `(3,)` bool, whether the kind of that nearest obstacle moves.
        goal_bearing_rad: direction of the scene's goal from the car's heading, left positive.
        goal_distance_m: distance of the scene's goal from the car's centre.
        pose: pose of the car.
        scene: name of the scene.
        scene_hash: `Scene.hash()`; it groups the pictures of one scene.
    """

    image: np.ndarray
    ray_clearance_m: np.ndarray
    ray_dynamic: np.ndarray
    ray_segment: np.ndarray
    clearance_m: np.ndarray
    dynamic: np.ndarray
    goal_bearing_rad: float
    goal_distance_m: float
    pose: Pose
    scene: str
    scene_hash: str


def labelled_views(
    families: list[str], split: Split, count: int, seed: int, camera: CameraConfig, varied: bool = False
) -> Iterator[LabelledView]:
    """Yield labelled pictures, the same for the same arguments. Families alternate; a scene gives several pictures.

    Args:
        families: names of families in `families.FAMILIES`.
        split: range of the families' seeds for the scenes; an unknown one raises `SceneError`.
        count: number of pictures.
        seed: seed of scenes, poses and appearance.
        camera: resolution, field of view, mount and range.
        varied: whether colours, textures, grounds, renderer, mount and picture quality are random (for training); else
            scenes have the appearance of a drive, drawn by the camera's own back end.
    """
    rng = random_streams.labelled_pictures(seed, split)
    for _, scene, number in drawn_scenes(families, split, count, rng):
        yield from _views_of(scene, number, rng, camera, varied)


def fresh_views(
    families: list[str], split: Split, count: int, seed: int, camera: CameraConfig
) -> Iterator[LabelledView]:
    """Yield varied pictures for a training that never ends; arguments as in `labelled_views`.

    They vary more than those of `labelled_views`: boxes have any height, and obstacles may look like the ground.
    """
    rng = random_streams.fresh_pictures(seed, split)
    for _, scene, number in drawn_scenes(families, split, count, rng, _FRESH_POSES):
        drawn = boxes_of_any_height(scene, rng) if rng.random() < _ANY_HEIGHT_SHARE else scene
        yield from _views_of(drawn, number, rng, camera, True, _DISGUISED_SHARE)


def boxes_of_any_height(scene: Scene, rng: np.random.Generator) -> Scene:
    """Return the scene with random heights of its boxes, and the same ground plan."""

    def changed(obstacle: Obstacle) -> Obstacle:
        if obstacle.kind != "box" or obstacle.size_m is None:
            return obstacle
        height_m = round(float(rng.uniform(*_BOX_HEIGHT_M)), 2)
        return dataclasses.replace(obstacle, size_m=(*obstacle.size_m[:2], height_m))

    return dataclasses.replace(scene, obstacles=tuple(map(changed, scene.obstacles)))


def label(scene: Scene, pose: Pose, camera: CameraConfig, people: np.ndarray | None = None) -> dict[str, Any]:
    """Return the ground truth at one pose: the label fields of `LabelledView`.

    Args:
        scene: scene with its obstacles.
        pose: pose of the car.
        camera: field of view, mount and range.
        people: `(W, 2)`, positions of the walking obstacles; None: their start positions.
    """
    angles_rad = camera_angles_rad(camera)
    met = rays_met(scene, pose, camera, angles_rad, people)
    clearance_m, dynamic = nearest(met.distance_m, met.dynamic, angles_rad)
    bearing_rad, goal_m = pose.towards(*scene.goal)
    return {
        "ray_clearance_m": met.distance_m.astype(np.float32),
        "ray_dynamic": met.dynamic,
        "ray_segment": met.segment,
        "clearance_m": clearance_m,
        "dynamic": dynamic,
        "goal_bearing_rad": bearing_rad,
        "goal_distance_m": goal_m,
    }


def camera_angles_rad(camera: CameraConfig) -> np.ndarray:
    """Return the angles `(R,)` of the rays on which the visual-act model is trained, left positive, leftmost first."""
    return ray_angles_rad(RAYS, math.radians(camera.field_of_view_deg))


def _views_of(
    scene: Scene,
    count: int,
    rng: np.random.Generator,
    config: CameraConfig,
    varied: bool,
    disguised_share: float = 0.0,
) -> Iterator[LabelledView]:
    with contextlib.closing(
        varied_camera(_any_back_end(config, rng), rng, disguised_share=disguised_share)
        if varied
        else make_camera(config)
    ) as camera:
        for _ in range(count):
            people = people_on_paths(scene, rng)
            pose = free_pose(scene, rng, people)
            roll, pitch = rng.uniform(-_TILT_JITTER_RAD, _TILT_JITTER_RAD, 2) if varied else (0.0, 0.0)
            image = camera.render(scene, pose, roll, pitch, people)
            if varied:
                image = degrade(image, rng)
            yield LabelledView(
                image=image, pose=pose, scene=scene.name, scene_hash=scene.hash(), **label(scene, pose, config, people)
            )


def _any_back_end(config: CameraConfig, rng: np.random.Generator) -> CameraConfig:
    return config.model_copy(update={"back_end": "pybullet" if rng.random() < _PYBULLET_SHARE else "caster"})
