"""Pictures on which a trained model is checked: the wilderness, and sets that each differ from training in one way.

All scenes are of the test split, so that no choice was made on them.
"""

import contextlib
import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from zsdist.config import CameraConfig
from zsdist.datasets.degradation import degrade
from zsdist.datasets.labelled import camera_angles_rad, label
from zsdist.datasets.sampling import drawn_scenes, free_pose, people_on_paths, varied_camera
from zsdist.sim.camera import Camera, make_camera
from zsdist.sim.ground_truth import rays_met
from zsdist.sim.scenes.manifest import OOD_FAMILIES, TRAINED_GROUNDS, WITHHELD_GROUNDS
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose

_TILT_RAD = 0.05  # of the car in pictures that are varied as in training


class Sample(NamedTuple):
    """A picture, its depth image, where it was taken, and the truth about it.

    Attributes:
        image: `(px, px, 3)` uint8.
        depth_m: `(px, px)` float32.
        scene: it is of, on the ground it stands on.
        family: of the scene.
        pose: of the car.
        truth: as of `views.label`.
        objects: `(R,)` int64, a number of the obstacle that each ray meets, negative where it is none.
    """

    image: np.ndarray
    depth_m: np.ndarray
    scene: Scene
    family: str
    pose: Pose
    truth: dict[str, Any]
    objects: np.ndarray


@dataclasses.dataclass(frozen=True)
class PictureSet:
    """What the pictures of a set are of.

    Attributes:
        title: in tables and figures.
        families: which take turns.
        grounds: of the scenes in turn instead of their own; none: their own.
        varied: looks, mount and wear drawn as in training; else each scene looks as when driven through.
        back_end: of the camera instead of the configured one.
    """

    title: str
    families: tuple[str, ...]
    grounds: tuple[str, ...] = ()
    varied: bool = False
    back_end: str | None = None


SETS: dict[str, PictureSet] = {
    "same": PictureSet("as in training", ("street", "varied"), varied=True),
    "new_kinds": PictureSet(
        "new kinds",
        ("ood-clusters", "ood-start-goal", "ood-appearance", "ood-all"),
        grounds=TRAINED_GROUNDS,
    ),
    "new_grounds": PictureSet("new ground", ("street", "varied"), grounds=WITHHELD_GROUNDS),
    "both": PictureSet("new kinds and ground", ("ood-appearance", "ood-all")),
    "other_renderer_urban": PictureSet("other renderer, street", ("street", "varied"), back_end="pybullet"),
    "other_renderer_wild": PictureSet("other renderer, wild", OOD_FAMILIES, back_end="pybullet"),
}
WILDERNESS = PictureSet("wilderness", OOD_FAMILIES)


def wilderness(count: int, seed: int, camera: CameraConfig) -> Iterator[Sample]:
    """Pictures of scenes from the families and seeds that are kept for tests, as they look when driven through."""
    return samples(WILDERNESS, count, np.random.default_rng([seed, 2]), camera)


def of_set(name: str, count: int, seed: int, camera: CameraConfig) -> Iterator[Sample]:
    """Pictures of the set `name` of `SETS`, the same for the same arguments."""
    return samples(SETS[name], count, np.random.default_rng([seed, 4, list(SETS).index(name)]), camera)


def samples(pictures: PictureSet, count: int, rng: np.random.Generator, camera: CameraConfig) -> Iterator[Sample]:
    """`count` pictures of a set; the families take turns, a scene gives several."""
    if pictures.back_end is not None:
        camera = camera.model_copy(update={"back_end": pictures.back_end})
    grounds = itertools.cycle(pictures.grounds or (None,))
    for family, scene, number in drawn_scenes(pictures.families, "test", count, rng):
        ground = next(grounds)
        if ground is not None:
            scene = dataclasses.replace(scene, ground=ground)
        with contextlib.closing(varied_camera(camera, rng) if pictures.varied else make_camera(camera)) as eye:
            for _ in range(number):
                yield (_varied_shot if pictures.varied else _plain_shot)(eye, scene, family, rng)


def sample_at(eye: Camera, scene: Scene, family: str, pose: Pose, people: np.ndarray | None = None) -> Sample:
    """What a level camera sees from a pose of the car."""
    image, depth_m, _ = eye.render_labelled(scene, pose, people=people)
    truth = label(scene, pose, eye.config, people)
    objects = rays_met(scene, pose, eye.config, camera_angles_rad(eye.config), people).obstacle
    return Sample(image, depth_m, scene, family, pose, truth, objects)


def _plain_shot(eye: Camera, scene: Scene, family: str, rng: np.random.Generator) -> Sample:
    return sample_at(eye, scene, family, free_pose(scene, rng))


def _varied_shot(eye: Camera, scene: Scene, family: str, rng: np.random.Generator) -> Sample:
    people = people_on_paths(scene, rng)
    pose = free_pose(scene, rng, people)
    image, depth_m, _ = eye.render_labelled(scene, pose, *rng.uniform(-_TILT_RAD, _TILT_RAD, 2), people)
    truth = label(scene, pose, eye.config, people)
    objects = rays_met(scene, pose, eye.config, camera_angles_rad(eye.config), people).obstacle
    return Sample(degrade(image, rng), depth_m, scene, family, pose, truth, objects)
