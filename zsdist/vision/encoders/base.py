"""What an image encoder is, and how pictures are brought to its size."""

from typing import Protocol

import numpy as np


class Encoder(Protocol):
    """What the heads need of an encoder."""

    name: str
    sha256: str

    def tokens(self, images: np.ndarray) -> np.ndarray:
        """Tokens `(B, side, side, features)` float32 of images `(B, px, px, 3)` uint8, from the top left."""


def check_images(images: np.ndarray) -> None:
    """Raises `ValueError` unless `images` is `(B, px, px, 3)` uint8, square, of 32 pixels a side or more."""
    shape, dtype = np.shape(images), getattr(images, "dtype", type(images).__name__)
    if dtype != np.uint8 or len(shape) != 4 or shape[0] < 1 or shape[3] != 3 or shape[1] != shape[2] or shape[1] < 32:
        raise ValueError(f"images are {shape} {dtype}; allowed are (batch, px, px, 3) uint8, square, px of 32 or more")


def resample(images: np.ndarray, size_px: int) -> np.ndarray:
    """Square images at another size, `(B, size_px, size_px, 3)` uint8; each new pixel is the mean of what it covers."""
    side = images.shape[1]
    if side == size_px:
        return images
    weights = _coverage(side, size_px)
    rows = np.einsum("ij,bjkc->bikc", weights, images.astype(np.float32), optimize=True)
    return np.rint(np.einsum("ij,bkjc->bkic", weights, rows, optimize=True)).clip(0, 255).astype(np.uint8)


def _coverage(old: int, new: int) -> np.ndarray:
    """`(new, old)` weights of a row of old pixels in new ones: a triangle as wide as the coarser of the two grids."""
    centres = (np.arange(new) + 0.5) * old / new
    distance = np.abs(centres[:, None] - (np.arange(old) + 0.5)) / max(1.0, old / new)
    weights = np.clip(1 - distance, 0, None)
    return (weights / weights.sum(1, keepdims=True)).astype(np.float32)
