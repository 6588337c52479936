"""Random scenes, poses, walkers and cameras for the pictures of pretraining."""

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from zsdist.config import CameraConfig
from zsdist.sim.camera import Camera, appearance, make_camera
from zsdist.sim.camera.appearance import Appearance
from zsdist.sim.camera.primitives import ARENA_HALF_M, Primitives
from zsdist.sim.physics.collision import touching
from zsdist.sim.scenes.families import generate
from zsdist.sim.scenes.manifest import Split, split_seed
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose

POSES_PER_SCENE = 8
PLACE_HALF_M = 11.0  # x and y of poses are drawn between minus and plus this
NATURAL_SHARE = 0.25  # share of varied cameras that show scenes with the appearance of a drive
_SCENES = 1_000_000  # number of scenes of a family and split from which one is drawn
_NEAR_SHARE = 0.6  # share of poses that face an obstacle close by; with fewer, most pictures would be empty
_NEAR_M = (0.9, 4.5)  # distance of the car's centre from the surface of that obstacle
_MOUNT_JITTER_M = 0.15


def drawn_scenes(
    families: Sequence[str], split: Split, count: int, rng: np.random.Generator, poses: int = POSES_PER_SCENE
) -> Iterator[tuple[str, Scene, int]]:
    """Yield scenes for `count` pictures, each as (family, scene, number of pictures to take in it).

    Each scene is drawn when it is requested, so that its pictures can use the same `rng`.

    Args:
        families: names of the families, which alternate.
        split: range of the families' seeds for the scenes; an unknown one raises `SceneError`.
        count: number of pictures.
        rng: source of the scenes.
        poses: number of pictures in a scene.
    """
    left, turns = count, itertools.cycle(families)
    while left > 0:
        family = next(turns)
        number = min(poses, left)
        yield family, generate(family, split_seed(split, int(rng.integers(_SCENES)))), number
        left -= number


def free_pose(scene: Scene, rng: np.random.Generator, people: np.ndarray | None = None) -> Pose:
    """Return a random pose in which the car touches nothing; in most cases it faces an obstacle close by."""
    circles, boxes = scene.circles(people), scene.boxes()
    while True:
        if scene.obstacles and rng.random() < _NEAR_SHARE:
            pose = _near_pose(circles, boxes, rng)
        else:
            x_m, y_m = rng.uniform(-PLACE_HALF_M, PLACE_HALF_M, 2)
            pose = Pose(x_m, y_m, rng.uniform(-math.pi, math.pi))
        if max(abs(pose.x_m), abs(pose.y_m)) <= PLACE_HALF_M and not touching(
            pose, circles, boxes, arena_m=2 * ARENA_HALF_M
        ):
            return pose


def people_on_paths(scene: Scene, rng: np.random.Generator) -> np.ndarray | None:
    """Return random positions of the walking obstacles on their paths, `(W, 2)`; None if there are none."""
    positions = []
    for obstacle in scene.walkers():
        start = int(rng.integers(max(len(obstacle.path) - 1, 1)))
        first, last = np.array(obstacle.path[start]), np.array(obstacle.path[(start + 1) % len(obstacle.path)])
        positions.append(first + rng.random() * (last - first))
    return np.array(positions) if positions else None


def varied_camera(
    config: CameraConfig,
    rng: np.random.Generator,
    natural_share: float = NATURAL_SHARE,
    disguised_share: float = 0.0,
) -> Camera:
    """Return a camera at a random height that shows scenes with a random appearance, or with that of a drive.

    Args:
        config: settings of the camera; its height is varied.
        rng: source of height and appearance.
        natural_share: share of cameras that show scenes with the appearance of a drive.
        disguised_share: share of the others whose scenes have obstacles in the colours of the ground.
    """
    natural = rng.random() < natural_share
    height = config.height_m + rng.uniform(-_MOUNT_JITTER_M, _MOUNT_JITTER_M)

    def look(scene: Scene, primitives: Primitives) -> Appearance:
        if natural:
            return appearance.of_scene(scene, primitives)
        drawn = appearance.varied(scene, primitives, rng)
        if disguised_share and rng.random() < disguised_share:
            return appearance.disguised(drawn, primitives, rng)
        return drawn

    return make_camera(config.model_copy(update={"height_m": height}), look)


def _near_pose(circles: np.ndarray, boxes: np.ndarray, rng: np.random.Generator) -> Pose:
    """Return a pose that roughly faces a random obstacle at `_NEAR_M` from its edge; it may collide."""
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
