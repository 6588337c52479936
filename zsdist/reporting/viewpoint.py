"""The ray caster's pictures from anywhere, not only from the car."""

import math

from zsdist.config import CameraConfig
from zsdist.sim.camera.caster import CasterCamera, Look


def lifted_camera(
    height_m: float, pitch_rad: float, field_of_view_deg: float, size_px: int, look: Look | None = None
) -> CasterCamera:
    """A camera that floats `height_m` above the place it is rendered from, if rendered with this pitch.

    Args:
        height_m: above the ground.
        pitch_rad: downwards; give the same to `render`.
        field_of_view_deg: of the picture's side.
        size_px: of the picture's side.
        look: of the scenes; None: their own.
    """
    # The mount turns with the body, so the place straight above is given along the body's tilted axes.
    config = CameraConfig(
        size_px=size_px,
        field_of_view_deg=field_of_view_deg,
        forward_m=-height_m * math.sin(pitch_rad),
        height_m=height_m * math.cos(pitch_rad),
    )
    return CasterCamera(config) if look is None else CasterCamera(config, look)
