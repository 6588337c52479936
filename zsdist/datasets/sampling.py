"""Random scenes, poses, walkers and cameras from which pictures for pretraining are taken."""

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from zsdist.config import CameraConfig
from zsdist.sim.camera import Camera, appearance, make_camera
from zsdist.sim.camera.primitives import ARENA_HALF_M
from zsdist.sim.physics.collision import touching
from zsdist.sim.scenes.families import generate
from zsdist.sim.scenes.manifest import Split, split_seed
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose

POSES_PER_SCENE = 8
PLACE_HALF_M = 11.0  # poses are drawn within plus and minus this
NATURAL_SHARE = 0.25  # of varied cameras that show scenes as they look when driven through
_SCENES = 1_000_000  # of a family and split, from which those of a call are drawn
_NEAR_SHARE = 0.6  # of the poses look at an obstacle from close by; elsewhere most pictures would be empty
_NEAR_M = (0.9, 4.5)  # from its surface, of the car's centre
_MOUNT_JITTER_M = 0.15


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


def people_on_paths(scene: Scene, rng: np.random.Generator) -> np.ndarray | None:
    """Walking obstacles somewhere on their paths, `(W, 2)`."""
    places = []
    for obstacle in scene.walkers():
        start = int(rng.integers(max(len(obstacle.path) - 1, 1)))
        first, last = np.array(obstacle.path[start]), np.array(obstacle.path[(start + 1) % len(obstacle.path)])
        places.append(first + rng.random() * (last - first))
    return np.array(places) if places else None


def varied_camera(config: CameraConfig, rng: np.random.Generator, natural_share: float = NATURAL_SHARE) -> Camera:
    """Camera at a random height, to which a scene looks as drawn at random or as when driven through.

    Args:
        config: of the camera whose height is varied.
        rng: draws height and looks.
        natural_share: of cameras that show scenes as they look when driven through.
    """
    natural = rng.random() < natural_share
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
