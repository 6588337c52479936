"""Labelled pictures from random places in random scenes: what the visual-act model is trained and tested on."""

import contextlib
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from zsdist.config import CameraConfig
from zsdist.datasets.degradation import worn
from zsdist.sim.camera import Camera, appearance, make_camera
from zsdist.sim.camera.primitives import ARENA_HALF_M
from zsdist.sim.physics.collision import touching
from zsdist.sim.physics.raycast import ray_distances
from zsdist.sim.scenes.families import generate
from zsdist.sim.scenes.kinds import KINDS, SEGMENT_WALL
from zsdist.sim.scenes.manifest import Split, split_seed
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose
from zsdist.vision.labels import nearest
from zsdist.vision.rays import RAYS, ray_angles_rad

POSES_PER_SCENE = 8
_SCENES = 1_000_000  # of a family and split, from which those of a call are drawn
PLACE_HALF_M = 11.0  # places are drawn within plus and minus this
_NEAR_SHARE = 0.6  # of the poses look at an obstacle from close by; elsewhere most pictures would be empty
_NEAR_M = (0.9, 4.5)  # from its surface, of the car's centre
_PYBULLET_SHARE = 0.12  # of the scenes for training are drawn by it: four times as slow, and without textures
_MOUNT_JITTER_M = 0.15
_TILT_JITTER_RAD = 0.05


@dataclass(frozen=True)
class LabelledView:
    """One picture and the truth about it, for R rays and the directions forward, left, right.

    Attributes:
        image: `(size_px, size_px, 3)` uint8.
        ray_clearance_m: `(R,)` float32, horizontal distance from the camera along each ray, leftmost first, capped at
            the camera's range, which stands for "free".
        ray_dynamic: `(R,)` bool, whether what the ray meets is of a kind that moves.
        ray_segment: `(R,)` uint8, what the ray meets: `Kind.segment_id`, `SEGMENT_WALL`, or 0 where it is free.
        clearance_m: `(3,)` float32, the nearest of each direction's rays.
        dynamic: `(3,)` bool, whether that nearest is of a kind that moves.
        goal_bearing_rad: of the scene's goal from the car's heading, left positive.
        goal_distance_m: of the goal from the car's centre.
        pose: of the car.
        scene: name of the scene.
        scene_hash: `Scene.hash()`, by which pictures of one scene can be kept together.
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
    """Pictures with labels, the same for the same arguments; the families take turns, a scene gives several.

    Args:
        families: their names, as of `families.FAMILIES`.
        split: which range of the families' seeds the scenes come from; an unknown one raises `SceneError`.
        count: of pictures.
        seed: of scenes, places and looks.
        camera: resolution, field of view, mount and range.
        varied: colours, textures, grounds, renderer, mount and picture quality drawn without mercy (for training);
            else each scene looks as it does when driven through, drawn by the camera's own back end.
    """
    rng = np.random.default_rng([seed, *split.encode()])
    for _, scene, number in drawn_scenes(families, split, count, rng):
        yield from _views_of(scene, number, rng, camera, varied)


def drawn_scenes(
    families: Sequence[str], split: Split, count: int, rng: np.random.Generator
) -> Iterator[tuple[str, Scene, int]]:
    """Scenes for `count` pictures, each with its family and how many of them are to be taken in it.

    Each scene is drawn when it is asked for, so that `rng` can serve for its pictures as well.

    Args:
        families: which take turns.
        split: which range of the families' seeds the scenes come from; an unknown one raises `SceneError`.
        count: of pictures.
        rng: draws the scenes.
    """
    left, turns = count, itertools.cycle(families)
    while left > 0:
        family = next(turns)
        number = min(POSES_PER_SCENE, left)
        yield family, generate(family, split_seed(split, int(rng.integers(_SCENES)))), number
        left -= number


def label(scene: Scene, pose: Pose, camera: CameraConfig, people: np.ndarray | None = None) -> dict[str, Any]:
    """The truth of one pose: the label fields of `LabelledView`.

    Args:
        scene: what stands in the arena.
        pose: of the car.
        camera: field of view, mount and range.
        people: `(W, 2)` places of the walking obstacles; None: where they start.
    """
    angles = ray_angles_rad(RAYS, math.radians(camera.field_of_view_deg))
    distance, hit = rays_met(scene, pose, camera, people)
    kinds = [KINDS[kind] for kind in _kinds_by_hit(scene)]
    moves = np.array([kind.dynamic for kind in kinds] + [False])
    ray_dynamic = moves[np.maximum(hit, -1)]  # the last entry is of what no obstacle is hit by
    segments = np.array([kind.segment_id for kind in kinds] + [SEGMENT_WALL, 0], np.uint8)  # hits of -2 and -1 last
    clearance, dynamic = nearest(distance, ray_dynamic, angles)
    bearing, goal_m = pose.towards(*scene.goal)
    return {
        "ray_clearance_m": distance.astype(np.float32),
        "ray_dynamic": ray_dynamic,
        "ray_segment": segments[hit],
        "clearance_m": clearance,
        "dynamic": dynamic,
        "goal_bearing_rad": bearing,
        "goal_distance_m": goal_m,
    }


def rays_met(
    scene: Scene, pose: Pose, camera: CameraConfig, people: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """How far each of the camera's rays goes, and what it meets, both `(R,)`, as of `raycast.ray_distances`.

    Arguments as of `label`.
    """
    x_m = pose.x_m + camera.forward_m * math.cos(pose.heading_rad)
    y_m = pose.y_m + camera.forward_m * math.sin(pose.heading_rad)
    headings = pose.heading_rad + ray_angles_rad(RAYS, math.radians(camera.field_of_view_deg))
    return ray_distances(scene.circles(people), scene.boxes(), ARENA_HALF_M, x_m, y_m, headings, camera.range_m)


def free_pose(scene: Scene, rng: np.random.Generator, people: np.ndarray | None = None) -> Pose:
    """A random pose in which the car touches nothing; more often than not it looks at an obstacle close by."""
    circles, boxes = scene.circles(people), scene.boxes()
    while True:
        if scene.obstacles and rng.random() < _NEAR_SHARE:
            pose = _near_pose(circles, boxes, rng)
        else:
            pose = Pose(*rng.uniform(-PLACE_HALF_M, PLACE_HALF_M, 2), rng.uniform(-math.pi, math.pi))
        if max(abs(pose.x_m), abs(pose.y_m)) <= PLACE_HALF_M and not touching(
            pose, circles, boxes, arena_m=2 * ARENA_HALF_M
        ):
            return pose


def _views_of(
    scene: Scene, count: int, rng: np.random.Generator, config: CameraConfig, varied: bool
) -> Iterator[LabelledView]:
    with contextlib.closing(
        varied_camera(_any_back_end(config, rng), rng) if varied else make_camera(config)
    ) as camera:
        for _ in range(count):
            people = people_on_paths(scene, rng)
            pose = free_pose(scene, rng, people)
            roll, pitch = rng.uniform(-_TILT_JITTER_RAD, _TILT_JITTER_RAD, 2) if varied else (0.0, 0.0)
            image = camera.render(scene, pose, roll, pitch, people)
            if varied:
                image = worn(image, rng)
            yield LabelledView(
                image=image, pose=pose, scene=scene.name, scene_hash=scene.hash(), **label(scene, pose, config, people)
            )


def _any_back_end(config: CameraConfig, rng: np.random.Generator) -> CameraConfig:
    return config.model_copy(update={"back_end": "pybullet" if rng.random() < _PYBULLET_SHARE else "caster"})


def varied_camera(config: CameraConfig, rng: np.random.Generator) -> Camera:
    """A camera at a drawn height to which scenes look as drawn, one in four of them as when driven through."""
    natural = rng.random() < 0.25
    height = config.height_m + rng.uniform(-_MOUNT_JITTER_M, _MOUNT_JITTER_M)

    def look(scene, primitives):  # noqa: ANN001, ANN202 (a Look)
        return appearance.of_scene(scene, primitives) if natural else appearance.varied(scene, primitives, rng)

    return make_camera(config.model_copy(update={"height_m": height}), look)


def _near_pose(circles: np.ndarray, boxes: np.ndarray, rng: np.random.Generator) -> Pose:
    """A pose that looks roughly at a random obstacle from `_NEAR_M` of its edge; it may collide."""
    chosen = rng.integers(len(circles) + len(boxes))
    away = rng.uniform(-math.pi, math.pi)
    if chosen < len(circles):
        x, y, reach = circles[chosen]
    else:
        x, y, length, width, heading = boxes[chosen - len(circles)]
        side = away - heading
        reach = min(length / 2 / max(abs(math.cos(side)), 1e-9), width / 2 / max(abs(math.sin(side)), 1e-9))
    distance = reach + rng.uniform(*_NEAR_M)
    return Pose(
        x + distance * math.cos(away),
        y + distance * math.sin(away),
        math.remainder(away + math.pi + rng.normal(0, 0.5), math.tau),
    )


def people_on_paths(scene: Scene, rng: np.random.Generator) -> np.ndarray | None:
    """Walking obstacles somewhere on their paths, `(W, 2)`."""
    places = []
    for obstacle in scene.walkers():
        start = int(rng.integers(max(len(obstacle.path) - 1, 1)))
        first, last = np.array(obstacle.path[start]), np.array(obstacle.path[(start + 1) % len(obstacle.path)])
        places.append(first + rng.random() * (last - first))
    return np.array(places) if places else None


def _kinds_by_hit(scene: Scene) -> list[str]:
    """Kinds in the order of `ray_distances`: round ones, then boxes."""
    return [o.kind for o in scene.obstacles if o.size_m is None] + [
        o.kind for o in scene.obstacles if o.size_m is not None
    ]
