"""Random degradation of training pictures, as by real cameras: gain, colour cast, contrast, blur and noise."""

import cv2
import numpy as np


def degrade(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a picture `(H, W, 3)` uint8 as a worse camera would take it; one in five stays unchanged."""
    if rng.random() < 0.2:
        return image
    if rng.random() < 0.5:
        image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 1.6))
    values = image.astype(np.float32)
    level = values.mean()
    contrast, cast = rng.uniform(0.7, 1.3), rng.uniform(0.85, 1.15, 3).astype(np.float32)
    # At most towards middle grey: a black picture carries no information.
    shift = rng.uniform(-0.2, 0.2) * level + rng.uniform(0, 0.4) * (127.0 - level)
    values = (values - level) * (contrast * cast) + level + shift
    if rng.random() < 0.2:  # less saturation
        values += rng.uniform(0.3, 1.0) * (values.mean(-1, keepdims=True) - values)
    if rng.random() < 0.6:
        values += rng.standard_normal(values.shape, np.float32) * rng.uniform(1, 14)
    return np.clip(values, 0, 255).astype(np.uint8)
