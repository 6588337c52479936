"""Cameras of the ray caster at viewpoints other than the car's."""

import math

from zsdist.config import CameraConfig
from zsdist.sim.camera.caster import CasterCamera, Look


def lifted_camera(
    height_m: float, pitch_rad: float, field_of_view_deg: float, size_px: int, look: Look | None = None
) -> CasterCamera:
    """Return a camera that is `height_m` above the pose it is rendered from, if rendered with this pitch.

    Args:
        height_m: height above the ground.
        pitch_rad: pitch downwards; pass the same to `render`.
        field_of_view_deg: field of view across the picture's width.
        size_px: width and height of the picture.
        look: function that returns the appearance of a scene; None: the scene's own appearance.
    """
    # The mount tilts with the body, so the point straight above is given along the body's tilted axes.
    config = CameraConfig(
        size_px=size_px,
        field_of_view_deg=field_of_view_deg,
        forward_m=-height_m * math.sin(pitch_rad),
        height_m=height_m * math.cos(pitch_rad),
    )
    return CasterCamera(config) if look is None else CasterCamera(config, look)
