"""Attention as a heat map over a picture.

Attention is a softmax and sums to 1 even where there is nothing to look at; with free ground ahead it then rests on the
sky. So the heat map of a direction is as faint as the network believes that nothing is within its range there.
"""

import cv2
import matplotlib
import numpy as np

COLOURS = "inferno"
STRENGTH = 0.75


def seen_share(clearance: np.ndarray) -> np.ndarray:
    """Return the probability that something is within range, from distributions of clearance `(..., BINS)`."""
    return 1.0 - clearance[..., -1]


def overlay(field: np.ndarray, px: int, seen: float = 1.0) -> np.ndarray:
    """Return weights `(side, side)` as an RGBA heat map `(px, px, 4)` in 0 to 1, transparent where they are small.

    Args:
        field: weights.
        px: side of the map in pixels.
        seen: share from `seen_share`, by which the map becomes fainter.
    """
    share = cv2.resize((field / field.max()).astype(np.float32), (px, px), interpolation=cv2.INTER_CUBIC).clip(0, 1)
    colours = matplotlib.colormaps[COLOURS](0.25 + 0.75 * share)
    colours[..., 3] = 0.85 * seen * share**0.6
    return colours


def attended(image: np.ndarray, field: np.ndarray, seen: float = 1.0) -> np.ndarray:
    """Return a picture `(px, px, 3)` uint8 with the heat map of `overlay` over it."""
    heat = overlay(field, len(image), seen)
    alpha = STRENGTH * heat[..., 3:]
    return np.round((1 - alpha) * image + 255 * alpha * heat[..., :3]).astype(np.uint8)
