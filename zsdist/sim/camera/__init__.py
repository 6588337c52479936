"""On-board camera: one interface, and two back ends that draw the same shapes."""

from typing import Protocol

import numpy as np

from zsdist.config import CameraConfig
from zsdist.sim.camera.appearance import of_scene
from zsdist.sim.camera.caster import CasterCamera, Look
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose

__all__ = ["Camera", "Look", "make_camera"]


class Camera(Protocol):
    """Interface of both back ends; arguments and results are those of `CasterCamera`."""

    config: CameraConfig

    def render(
        self, scene: Scene, pose: Pose, roll_rad: float = 0.0, pitch_rad: float = 0.0, people: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the picture `(size_px, size_px, 3)` uint8."""

    def render_labelled(
        self, scene: Scene, pose: Pose, roll_rad: float = 0.0, pitch_rad: float = 0.0, people: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return picture, depth in metres `(size_px, size_px)` float32 and segments `(size_px, size_px)` uint8."""

    def close(self) -> None:
        """Release resources; a picture raises `RuntimeError` afterwards, and closing again does nothing."""


def make_camera(config: CameraConfig, look: Look = of_scene) -> Camera:
    """Return the camera that `config.back_end` names: `caster`, or `pybullet` (TinyRenderer, the slow reference)."""
    if config.back_end == "pybullet":
        from zsdist.sim.camera.tiny import TinyCamera  # starts a PyBullet client, which the caster does not need

        return TinyCamera(config, look)
    return CasterCamera(config, look)
