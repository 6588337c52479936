"""Protocol of an image encoder, and the resampling of pictures to its size."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from zsdist.errors import ImageError

if TYPE_CHECKING:
    from onnxruntime import InferenceSession
    from tokenizers import Tokenizer

TEXTS_AT_ONCE = 64


class Encoder(Protocol):
    """Encoder of images to tokens, and of texts to embeddings g(T).

    f(I) is computed from tokens by a map into text space. CLIP has its own (`native_projection`); for the default
    encoder we train one.

    Attributes:
        name: name of the encoder, such as "efficientnet-lite0/block10" or "clip/vit-b-32".
        sha256: SHA-256 of the image tower's weights file, 64 hexadecimal digits.
        text_sha256: SHA-256 of the text tower's weights file; the tower is loaded at first use. Both towers may be in
            one file.
        input_px: side in pixels of the square images that need no resampling.
        side: number of tokens in a row and in a column.
        features: number of features of a token.
    """

    name: str
    sha256: str
    input_px: int
    side: int
    features: int

    @property
    def network_file(self) -> Path:
        """Exported image tower, an ONNX file with the input "image" and the output "tokens"."""

    @property
    def text_sha256(self) -> str:
        """SHA-256 of the text tower's weights file; raises like `embed_texts`."""

    def tokens(self, images: np.ndarray) -> np.ndarray:
        """Return tokens `(B, side, side, features)` float32 of images `(B, px, px, 3)` uint8, from the top left."""

    def embed_texts(self, texts: Sequence[str]) -> np.ndarray:
        """Return embeddings `(N, D)` float32 of texts, of unit length; the text tower is loaded at first use.

        Raises:
            WeightsError: the text tower is missing or damaged.
        """

    def native_projection(self) -> dict[str, np.ndarray] | None:
        """Return the encoder's own map of tokens into text space; None if it has none.

        The map is `{"weight": (D, features), "bias": (D,)}`, float32.
        """


def similarity(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return Eq. (2): cosines `(N, M)` between the rows of `a` `(N, D)` and of `b` `(M, D)`, of any lengths.

    Raises:
        ValueError: the arrays have other shapes, or a row has no direction.
    """
    a, b = np.asarray(a), np.asarray(b)
    if a.ndim != 2 or b.ndim != 2 or a.shape[1] != b.shape[1]:
        raise ValueError(f"embeddings are {a.shape} and {b.shape}; allowed are (N, D) and (M, D)")
    return unit(a) @ unit(b).T


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors `(..., D)` scaled to unit length; raise `ValueError` if one is zero or not finite."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    if not (np.isfinite(lengths) & (lengths > 0)).all():
        raise ValueError("a vector has no direction; allowed are finite vectors other than zero")
    return vectors / lengths


def check_images(images: np.ndarray) -> None:
    """Raise `ImageError` unless `images` is `(B, px, px, 3)` uint8, square, with 32 pixels or more along a side."""
    shape, dtype = np.shape(images), getattr(images, "dtype", type(images).__name__)
    if dtype != np.uint8 or len(shape) != 4 or shape[0] < 1 or shape[3] != 3 or shape[1] != shape[2] or shape[1] < 32:
        raise ImageError(f"images are {shape} {dtype}; allowed are (batch, px, px, 3) uint8, square, px of 32 or more")


def check_texts(texts: Sequence[str]) -> list[str]:
    """Return the texts as a list; raise `ValueError` unless they are a non-empty sequence of strings, not a string."""
    if isinstance(texts, str) or not len(texts) or not all(isinstance(text, str) for text in texts):
        raise ValueError(f"texts are {texts!r:.80}; allowed is a sequence of one text or more")
    return list(texts)


def run_text_tower(tokenizer: "Tokenizer", tower: "InferenceSession", texts: list[str]) -> np.ndarray:
    """Return embeddings `(N, D)` float32 of texts from a tower with input "ids" and output "embedding", in batches."""
    parts: list[np.ndarray] = []
    for begin in range(0, len(texts), TEXTS_AT_ONCE):
        encoded = tokenizer.encode_batch(texts[begin : begin + TEXTS_AT_ONCE])
        ids = np.array([one.ids for one in encoded], np.int64)
        parts += tower.run(["embedding"], {"ids": ids})
    return np.concatenate(parts)


def resample(images: np.ndarray, size_px: int) -> np.ndarray:
    """Return square images at another size, `(B, size_px, size_px, 3)` uint8; a new pixel is a mean over its area."""
    side = images.shape[1]
    if side == size_px:
        return images
    weights = _coverage(side, size_px)
    rows = np.einsum("ij,bjkc->bikc", weights, images.astype(np.float32), optimize=True)
    return np.rint(np.einsum("ij,bkjc->bkic", weights, rows, optimize=True)).clip(0, 255).astype(np.uint8)


def _coverage(old: int, new: int) -> np.ndarray:
    """Return weights `(new, old)` of old pixels in new ones along a row: triangles twice as wide as a coarser pixel."""
    centres = (np.arange(new) + 0.5) * old / new
    distance = np.abs(centres[:, None] - (np.arange(old) + 0.5)) / max(1.0, old / new)
    weights = np.clip(1 - distance, 0, None)
    return (weights / weights.sum(1, keepdims=True)).astype(np.float32)
