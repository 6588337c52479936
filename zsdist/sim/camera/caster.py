"""Default camera: a ray caster over the scene's own shapes, in numba, on one core and without OpenGL."""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from zsdist.config import CameraConfig
from zsdist.sim.camera.appearance import Appearance, of_scene
from zsdist.sim.camera.kernels import SKY, SKY_DEPTH_M, cast, look_up
from zsdist.sim.camera.optics import mount, tangents
from zsdist.sim.camera.primitives import ARENA_HALF_M, Primitives, primitives_of
from zsdist.sim.camera.shading import shade
from zsdist.sim.camera.shadows import shadow_corners, shadow_map
from zsdist.sim.camera.textures import noise_pyramid
from zsdist.sim.scenes.kinds import SEGMENT_GROUND, SEGMENT_SKY
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose

Look = Callable[[Scene, Primitives], Appearance]

INSTANCE_WALL, INSTANCE_GROUND, INSTANCE_SKY = -1, -2, -3  # the wall as in `Primitives.owners`

_SHADOW_CELLS = 256  # cells per side of the shadow map; 10 cm each, read with interpolation
_NO_DISCS = np.empty((0, 3))
_SCENES_KEPT = 32  # number of prepared scenes: one for each car of an actor, and some more


@dataclass(frozen=True)
class _PreparedScene:
    scene: Scene  # kept so that no other scene gets its `id`
    primitives: Primitives
    appearance: Appearance
    shadow: np.ndarray
    segments: np.ndarray  # segment numbers of the sky, the ground, then each primitive


class CasterCamera:
    """Ray-casting camera on the car. A scene is prepared at its first picture; prepared scenes are kept.

    A copy has no prepared scenes yet.

    Args:
        config: resolution, field of view and mount.
        look: function that gives the appearance of a scene; training pictures use a varied one.

    Attributes:
        config: resolution, field of view and mount.
    """

    def __init__(self, config: CameraConfig, look: Look = of_scene) -> None:
        self.config = config
        self._look = look
        self._closed = False
        self._kept: OrderedDict[int, _PreparedScene] = OrderedDict()
        size = config.size_px
        self._depth = np.empty((size, size), np.float32)
        self._index = np.empty((size, size), np.int32)
        self._packed = np.empty((size, size), np.int32)
        self._work = np.empty((12, size), np.float32)
        self._at = np.empty(size, np.uint32)
        self._tangents = tangents(size, float(np.deg2rad(config.field_of_view_deg)))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.config, self._look)

    def render(
        self, scene: Scene, pose: Pose, roll_rad: float = 0.0, pitch_rad: float = 0.0, people: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the picture `(size_px, size_px, 3)` uint8, RGB.

        Args:
            scene: scene to draw.
            pose: pose of the car.
            roll_rad: roll of the car's body, positive: right side down.
            pitch_rad: pitch of the car's body, positive: nose down.
            people: `(W, 2)` positions of the walking obstacles, in the order of the scene; None: at their start.
        """
        return self._draw(scene, pose, roll_rad, pitch_rad, people)[0]

    def render_labelled(
        self, scene: Scene, pose: Pose, roll_rad: float = 0.0, pitch_rad: float = 0.0, people: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the picture of `render`, depth `(size_px, size_px)` float32 and segments `(size_px, size_px)` uint8.

        Depth is in metres along the camera's axis, infinite for the sky; segments are `Kind.segment_id` and the
        `SEGMENT_` numbers of `kinds`.
        """
        image, prepared = self._draw(scene, pose, roll_rad, pitch_rad, people)
        segments = np.empty(self._index.shape, np.uint8)
        look_up(prepared.segments, self._index, segments)
        return image, self._depth_m(), segments

    def render_instances(
        self, scene: Scene, pose: Pose, roll_rad: float = 0.0, pitch_rad: float = 0.0, people: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return picture and depth of `render_labelled`, and the instance that each pixel shows.

        Instances are `(size_px, size_px)` int64: the index of the scene's obstacle, or one of `INSTANCE_WALL`,
        `INSTANCE_GROUND` and `INSTANCE_SKY`.
        """
        image, prepared = self._draw(scene, pose, roll_rad, pitch_rad, people)
        instances = np.concatenate([[INSTANCE_SKY, INSTANCE_GROUND], prepared.primitives.owners])
        return image, self._depth_m(), instances[self._index - SKY]

    def release_scenes(self) -> None:
        """Release the prepared scenes; each is prepared again when it is drawn."""
        self._kept.clear()

    def close(self) -> None:
        """Release the prepared scenes for good; closing again does nothing."""
        self._closed = True
        self._kept.clear()

    def _draw(
        self, scene: Scene, pose: Pose, roll_rad: float, pitch_rad: float, people: np.ndarray | None
    ) -> tuple[np.ndarray, _PreparedScene]:
        prepared = self._prepare(scene)
        primitives, look = prepared.primitives, prepared.appearance
        rows = primitives.rows_at(people)
        origin, axes = mount(pose, self.config.forward_m, self.config.height_m, roll_rad, pitch_rad)
        # Walking obstacles have no shadow in the map.
        discs = rows[primitives.walkers[:, 0]][:, [0, 1, 4]] if len(primitives.walkers) else _NO_DISCS
        rectangles = np.empty((len(rows), 4), np.int64)
        cast(primitives.forms, rows, origin, axes, self._tangents, self._depth, self._index, rectangles)
        shade(
            primitives.forms, rows, look.materials, look.ground, look.sky, look.light, prepared.shadow, ARENA_HALF_M,
            discs, noise_pyramid(), origin, axes, self._tangents, self._depth, self._index, rectangles,
            self._work, self._at, self._packed,
        )  # fmt: skip
        return cv2.cvtColor(self._packed.view(np.uint8).reshape(*self._packed.shape, 4), cv2.COLOR_RGBA2RGB), prepared

    def _depth_m(self) -> np.ndarray:
        return np.where(self._depth >= SKY_DEPTH_M, np.float32(np.inf), self._depth)

    def _prepare(self, scene: Scene) -> _PreparedScene:
        if self._closed:
            raise RuntimeError("the camera is closed; make another one")
        prepared = self._kept.get(id(scene))
        if prepared is not None:
            self._kept.move_to_end(id(scene))
            return prepared
        primitives = primitives_of(scene)
        appearance = self._look(scene, primitives)
        fixed = np.ones(len(primitives.forms), bool)
        for first, last in primitives.walkers:
            fixed[first:last] = False
        shadow = np.empty((_SHADOW_CELLS, _SHADOW_CELLS), np.float32)
        shadow_map(primitives.forms, primitives.rows, fixed, appearance.light[:3].copy(), ARENA_HALF_M, shadow)
        shadow = shadow_corners(shadow)
        segments = np.concatenate([[SEGMENT_SKY, SEGMENT_GROUND], primitives.segments]).astype(np.uint8)
        prepared = _PreparedScene(scene, primitives, appearance, shadow, segments)
        self._kept[id(scene)] = prepared
        if len(self._kept) > _SCENES_KEPT:
            self._kept.popitem(last=False)
        return prepared
