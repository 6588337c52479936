"""Pictures with masks of their objects, and the truth of the scene without each object, for the contrastive loss."""

import contextlib
import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from zsdist.common import random_streams
from zsdist.config import CameraConfig
from zsdist.datasets.degradation import degrade
from zsdist.datasets.labelled import label
from zsdist.datasets.sampling import drawn_scenes, free_pose, people_on_paths, varied_camera
from zsdist.errors import SceneError
from zsdist.sim.camera.caster import INSTANCE_GROUND, INSTANCE_SKY, CasterCamera
from zsdist.sim.scenes.manifest import Split
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose
from zsdist.vision.masks import Mask, MaskedView, choose_masks, pixel_distance_m


def masked_views(
    families: list[str], split: Split, count: int, seed: int, camera: CameraConfig, varied: bool = False
) -> Iterator[MaskedView]:
    """Yield pictures with their masks, the same for the same arguments; arguments as in `labelled.labelled_views`.

    The camera is level, so that a mask is where the truth of its object is. The arena's walls are never removed: near
    parts of them stay in every masked picture, far parts count as background.

    Raises:
        SceneError: the split is unknown, or the camera's back end does not number obstacles.
    """
    if camera.back_end != "caster":
        raise SceneError(f"camera.back_end is {camera.back_end!r}; allowed for pictures with masks is 'caster'")
    rng = random_streams.masked_pictures(seed, split)
    for _, scene, number in drawn_scenes(families, split, count, rng):
        eye = varied_camera(camera, rng) if varied else CasterCamera(camera)
        assert isinstance(eye, CasterCamera), "the back end was checked above"
        with contextlib.closing(eye):
            for _ in range(number):
                people = people_on_paths(scene, rng)
                view = masked_view(eye, scene, free_pose(scene, rng, people), people)
                yield dataclasses.replace(view, image=degrade(view.image, rng)) if varied else view


def masked_view(eye: CasterCamera, scene: Scene, pose: Pose, people: np.ndarray | None = None) -> MaskedView:
    """Return the picture of `eye` from a pose of the car, with its masks and the truth without each masked object."""
    image, depth_m, instances = eye.render_instances(scene, pose, people=people)
    config = eye.config
    distance_m = pixel_distance_m(depth_m, math.radians(config.field_of_view_deg))
    ground, sky = instances == INSTANCE_GROUND, instances == INSTANCE_SKY
    objects, background = choose_masks(instances, distance_m, ground, sky, config.range_m)

    def truth(of: Scene, walking: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        found = label(of, pose, config, walking)
        return found["ray_clearance_m"], found["ray_dynamic"]

    whole = truth(scene, people)
    masks = [Mask(hidden, False, *truth(*remove_obstacle(scene, index, people))) for index, hidden in objects.items()]
    masks += [Mask(hidden, True, *whole) for hidden in background]
    return MaskedView(image, *whole, tuple(masks), scene.hash())


def remove_obstacle(scene: Scene, index: int, people: np.ndarray | None) -> tuple[Scene, np.ndarray | None]:
    """Return the scene without its obstacle `index`, and the positions `(W, 2)` of its remaining people."""
    removed = scene.obstacles[index]
    if removed.walks and people is not None:
        people = np.delete(people, sum(other.walks for other in scene.obstacles[:index]), 0)
    return dataclasses.replace(scene, obstacles=scene.obstacles[:index] + scene.obstacles[index + 1 :]), people
