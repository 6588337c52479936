"""Pictures of the car from behind and above, with a mast at the goal, rendered by the ray caster."""

import math
from dataclasses import replace

import cv2
import numpy as np

from zsdist.planning.footprint import CAR_LENGTH_M, CAR_WIDTH_M
from zsdist.reporting.viewpoint import lifted_camera
from zsdist.sim.camera.appearance import Appearance, Texture, of_scene
from zsdist.sim.camera.primitives import ARENA_HALF_M, Part, Primitives, primitives_of
from zsdist.sim.scenes.scene import Obstacle, Scene
from zsdist.types import Pose

BEHIND_M, HEIGHT_M, PITCH_DEG, FIELD_OF_VIEW_DEG = 5.6, 6.6, 40.0, 75.0  # above the trees
WALL_GAP_M = 0.5  # least distance of the camera from the arena's walls
SMOOTHING_PX = 0.8  # without smoothing, the grain of the ground takes half of a film's bytes
BODY_M = (2.0, 0.7, 0.8)
WHEEL_M, WHEELBASE_M = (0.72, 0.16, 0.5), 1.1
MAST_RADIUS_M = 0.09
_PAINT, _GLASS, _TYRE, _MAST = (0.10, 0.42, 0.72), (0.06, 0.08, 0.10), (0.07, 0.07, 0.08), (0.88, 0.10, 0.10)


class ChaseCamera:
    """Camera that shows one scene with the car in it.

    Args:
        scene: scene that is driven.
        size_px: width and height of the pictures.
    """

    def __init__(self, scene: Scene, size_px: int) -> None:
        self._scene = scene
        primitives = primitives_of(scene)
        self._appearance = of_scene(scene, primitives)
        self._shapes = len(primitives.forms)
        self._pitch_rad = math.radians(PITCH_DEG)
        self._camera = lifted_camera(HEIGHT_M, self._pitch_rad, FIELD_OF_VIEW_DEG, size_px, self._appearance_of)

    def render(self, pose: Pose, people: np.ndarray | None) -> np.ndarray:
        """Return the picture `(px, px, 3)` uint8 of the car at a pose.

        Args:
            pose: pose of the car.
            people: `(W, 2)` metres, positions of the walking obstacles; None where nobody walks.
        """
        shown = replace(self._scene, obstacles=(*self._scene.obstacles, *self._mast(), *_car(pose)))
        picture = self._camera.render(shown, _behind(pose), pitch_rad=self._pitch_rad, people=people)
        self._camera.release_scenes()  # the scene with the car at this pose is not drawn again
        return cv2.GaussianBlur(picture, (0, 0), SMOOTHING_PX)

    def _mast(self) -> tuple[Obstacle]:
        return (Obstacle("pole", *self._scene.goal, radius_m=MAST_RADIUS_M),)

    def _appearance_of(self, scene: Scene, primitives: Primitives) -> Appearance:
        """Return the scene's own appearance, extended by the car and the mast."""
        added = []
        for owner, part in zip(primitives.owners[self._shapes :], primitives.parts[self._shapes :], strict=True):
            kind = scene.obstacles[owner].kind
            colour = _MAST if kind == "pole" else _TYRE if kind == "box" else _GLASS if part == Part.TOP else _PAINT
            added.append([*colour, *colour, Texture.PLAIN, 0.05, 0.02, 0.0, 1.0])
        return replace(self._appearance, materials=np.vstack([self._appearance.materials, added]))


def _car(pose: Pose) -> tuple[Obstacle, ...]:
    """Return the car's body and wheels as obstacles; the outer sides of the tyres are the car's width apart."""
    heading_deg = math.degrees(pose.heading_rad)
    cosine, sine = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    aside = CAR_WIDTH_M / 2 - WHEEL_M[1] / 2
    wheels = [
        Obstacle("box", pose.x_m + cosine * ahead - sine * left, pose.y_m + sine * ahead + cosine * left,
                 size_m=WHEEL_M, heading_deg=heading_deg)
        for ahead in (-WHEELBASE_M / 2, WHEELBASE_M / 2)
        for left in (-aside, aside)
    ]  # fmt: skip
    body = Obstacle("car", pose.x_m, pose.y_m, size_m=(CAR_LENGTH_M, *BODY_M[1:]), heading_deg=heading_deg)
    return (*wheels, body)


def _behind(pose: Pose) -> Pose:
    """Return the camera's pose: behind the car, closer where the arena's wall would be in between."""
    inside = ARENA_HALF_M - WALL_GAP_M
    distance = BEHIND_M
    for coordinate, direction in ((pose.x_m, math.cos(pose.heading_rad)), (pose.y_m, math.sin(pose.heading_rad))):
        if abs(direction) > 1e-9:
            room = (coordinate + inside) / direction if direction > 0 else (coordinate - inside) / direction
            distance = min(distance, max(room, 0.0))
    return pose._replace(
        x_m=pose.x_m - distance * math.cos(pose.heading_rad), y_m=pose.y_m - distance * math.sin(pose.heading_rad)
    )
