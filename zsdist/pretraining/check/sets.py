"""Sets of pictures on which a trained model is checked: the wilderness, and sets that differ from training in one way.

All scenes are from the test split, on which no choice is made.
"""

import contextlib
import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np

from zsdist.common import random_streams
from zsdist.config import CameraConfig
from zsdist.datasets.degradation import degrade
from zsdist.datasets.labelled import camera_angles_rad, label
from zsdist.datasets.sampling import drawn_scenes, free_pose, people_on_paths, varied_camera
from zsdist.sim.camera import Camera, make_camera
from zsdist.sim.ground_truth import rays_met
from zsdist.sim.scenes.manifest import OOD_FAMILIES, TRAINED_GROUNDS, WITHHELD_GROUNDS
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose

_TILT_RAD = 0.05  # largest roll and pitch of the car in varied pictures


class Sample(NamedTuple):
    """Picture with its depth image, scene, pose and ground truth.

    Attributes:
        image: `(px, px, 3)` uint8.
        depth_m: `(px, px)` float32, depth along the camera's axis.
        scene: scene, with the ground on which it is rendered.
        family: family of the scene.
        pose: pose of the car.
        truth: ground truth, as `datasets.labelled.label` returns it.
        objects: `(R,)` int64, number of the obstacle that each ray meets; negative: none.
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
    """Definition of a set of pictures.

    Attributes:
        title: title in tables and figures.
        families: families of the scenes, which alternate.
        grounds: grounds that replace those of the scenes, and alternate; empty: each scene keeps its own.
        varied: whether appearance, camera mount and degradation are drawn as in training; else scenes have the
            appearance of a drive.
        back_end: renderer in place of the configured one; None: the configured one.
    """

    title: str
    families: tuple[str, ...]
    grounds: tuple[str, ...] = ()
    varied: bool = False
    back_end: Literal["caster", "pybullet"] | None = None


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
    """Yield pictures of test scenes from the test families, with the appearance of a drive."""
    return samples(WILDERNESS, count, random_streams.check_wilderness(seed), camera)


def of_set(name: str, count: int, seed: int, camera: CameraConfig) -> Iterator[Sample]:
    """Yield pictures of a set of `SETS`, the same for the same arguments."""
    return samples(SETS[name], count, random_streams.check_set(seed, list(SETS).index(name)), camera)


def samples(pictures: PictureSet, count: int, rng: np.random.Generator, camera: CameraConfig) -> Iterator[Sample]:
    """Yield `count` pictures of a set; the families alternate, and a scene gives several pictures."""
    if pictures.back_end is not None:
        camera = camera.model_copy(update={"back_end": pictures.back_end})
    grounds = itertools.cycle(pictures.grounds or (None,))
    for family, scene, number in drawn_scenes(pictures.families, "test", count, rng):
        ground = next(grounds)
        if ground is not None:
            scene = dataclasses.replace(scene, ground=ground)
        open_camera = varied_camera(camera, rng) if pictures.varied else make_camera(camera)
        with contextlib.closing(open_camera):
            for _ in range(number):
                yield (_varied_sample if pictures.varied else _plain_sample)(open_camera, scene, family, rng)


def sample_at(camera: Camera, scene: Scene, family: str, pose: Pose, people: np.ndarray | None = None) -> Sample:
    """Return the sample of a level camera at a pose of the car."""
    image, depth_m, _ = camera.render_labelled(scene, pose, people=people)
    truth = label(scene, pose, camera.config, people)
    objects = rays_met(scene, pose, camera.config, camera_angles_rad(camera.config), people).obstacle
    return Sample(image, depth_m, scene, family, pose, truth, objects)


def _plain_sample(camera: Camera, scene: Scene, family: str, rng: np.random.Generator) -> Sample:
    return sample_at(camera, scene, family, free_pose(scene, rng))


def _varied_sample(camera: Camera, scene: Scene, family: str, rng: np.random.Generator) -> Sample:
    people = people_on_paths(scene, rng)
    pose = free_pose(scene, rng, people)
    roll_rad, pitch_rad = rng.uniform(-_TILT_RAD, _TILT_RAD, 2)
    image, depth_m, _ = camera.render_labelled(scene, pose, roll_rad, pitch_rad, people)
    truth = label(scene, pose, camera.config, people)
    objects = rays_met(scene, pose, camera.config, camera_angles_rad(camera.config), people).obstacle
    return Sample(degrade(image, rng), depth_m, scene, family, pose, truth, objects)
