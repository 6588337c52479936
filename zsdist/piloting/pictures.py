"""Pictures of any camera as the policy's camera would have taken them: square, with its field of view."""

import math

import cv2
import numpy as np

from zsdist.errors import DecodeError


def fit(picture: np.ndarray, field_of_view_deg: float | None, wanted_deg: float) -> np.ndarray:
    """Return the square part of a picture that has the wanted field of view.

    Where the camera sees less, the edge of its picture is repeated.

    Args:
        picture: `(h, w, 3)` uint8 of a camera without distortion.
        field_of_view_deg: its horizontal field of view; None: a square picture is taken as it is.
        wanted_deg: horizontal and vertical field of view that the policy expects.

    Raises:
        DecodeError: the picture is not square, and its field of view is not known.
    """
    height, width = picture.shape[:2]
    if field_of_view_deg is None:
        if height != width:
            raise DecodeError("shape", f"pictures are {width} x {height}; give the camera's angle by --camera-fov-deg")
        return picture
    focal_px = width / 2 / math.tan(math.radians(field_of_view_deg) / 2)
    side = max(round(2 * focal_px * math.tan(math.radians(wanted_deg) / 2)), 1)
    missing = [max(0, side - size) for size in (height, width)]
    if any(missing):
        (top, left), (bottom, right) = ([part // 2 for part in missing], [part - part // 2 for part in missing])
        picture = cv2.copyMakeBorder(picture, top, bottom, left, right, cv2.BORDER_REPLICATE)
        height, width = picture.shape[:2]
    first_row, first_column = (height - side) // 2, (width - side) // 2
    return np.ascontiguousarray(picture[first_row : first_row + side, first_column : first_column + side])
