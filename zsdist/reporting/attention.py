"""Attention as a heat map over a picture."""

import cv2
import matplotlib
import numpy as np

COLOURS = "inferno"


def overlay(field: np.ndarray, px: int) -> np.ndarray:
    """Return weights `(side, side)` as an RGBA heat map `(px, px, 4)` in 0 to 1, transparent where they are small."""
    share = cv2.resize((field / field.max()).astype(np.float32), (px, px), interpolation=cv2.INTER_CUBIC).clip(0, 1)
    colours = matplotlib.colormaps[COLOURS](0.25 + 0.75 * share)
    colours[..., 3] = 0.85 * share**0.6
    return colours


def attended(image: np.ndarray, field: np.ndarray, strength: float = 0.75) -> np.ndarray:
    """Return a picture `(px, px, 3)` uint8 with the heat map of weights `(side, side)` over it."""
    heat = overlay(field, len(image))
    alpha = strength * heat[..., 3:]
    return np.round((1 - alpha) * image + 255 * alpha * heat[..., :3]).astype(np.uint8)
