"""CLIP from a folder on this machine, in the layout of open_clip or Hugging Face; nothing is downloaded."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnxruntime

from zsdist.vision.encoders.base import check_images, check_texts, resample, run_text_tower
from zsdist.vision.encoders.clip_layouts import read_folder
from zsdist.vision.encoders.clip_tokenizer import read_tokenizer
from zsdist.vision.exported import cached_session, export, files_sha256

VERSION = 1
"""Version of the towers' code: exported towers of another version are not used."""


class ClipFolder:
    """CLIP's towers, run by onnxruntime on one thread; torch is imported only to build each at its first use.

    The tokens are the patches after the last norm. CLIP was trained to map only its class token into text space, so
    patches mapped by the same projection carry meaning less reliably than `embed_images` does.

    Images of another size are resampled with triangles, while the libraries use cubic interpolation.

    Raises:
        WeightsError: a file is missing, damaged, or of a model that is not a plain CLIP.
    """

    def __init__(self, folder: Path) -> None:
        self._clip, self._weights = read_folder(folder)
        self._folder = folder
        self.name = f"clip/{folder.resolve().name}"
        self.sha256 = self.text_sha256 = files_sha256(self._weights)  # the same files hold both towers
        self.input_px = self._clip.image_px
        self.side = self._clip.image_px // self._clip.patch_px
        self.features = self._clip.vision.width
        digest = hashlib.sha256(repr((VERSION, self.sha256, self._clip)).encode()).hexdigest()
        self._cached = f"clip-{digest[:16]}"
        self._texts: ClipTextEncoder | None = None
        self._session = cached_session(f"{self._cached}-image", self._build)

    @property
    def network_file(self) -> Path:
        """Exported image tower."""
        return self._session.path

    def tokens(self, images: np.ndarray) -> np.ndarray:
        """Return tokens `(B, side, side, features)` float32 of images `(B, px, px, 3)` uint8, from the top left.

        Raises:
            ImageError: `images` has another shape or dtype.
        """
        return self._run("tokens", images)

    def embed_images(self, images: np.ndarray) -> np.ndarray:
        """Return CLIP's own embeddings `(B, D)` float32 of images, of unit length; raises like `tokens`."""
        return self._run("embedding", images)

    def embed_texts(self, texts: Sequence[str]) -> np.ndarray:
        """Return embeddings `(N, D)` float32 of texts, of unit length; tokenizer and tower are loaded at first use.

        Raises:
            WeightsError: the folder lacks a tokenizer, or has a damaged one.
            ValueError: `texts` is not a list of texts.
        """
        texts = check_texts(texts)
        if self._texts is None:
            self._texts = ClipTextEncoder(self._folder, self._cached)
        return self._texts.embed(texts)

    def native_projection(self) -> dict[str, np.ndarray]:
        """Return CLIP's map of its class token into text space: `weight` `(D, features)`, and a zero `bias` `(D,)`."""
        from zsdist.vision.encoders.clip_towers import projection

        weight = projection(self._clip, self._weights).numpy()
        return {"weight": np.ascontiguousarray(weight), "bias": np.zeros(len(weight), np.float32)}

    def _run(self, output: str, images: np.ndarray) -> np.ndarray:
        check_images(images)
        return self._session.run([output], {"image": resample(images, self.input_px)})[0]

    def _build(self, out: Path) -> None:
        """Export the image tower and check it against torch."""
        import torch

        from zsdist.vision.encoders.clip_towers import image_tower

        with torch.random.fork_rng():  # construction draws initial weights, which are overwritten
            tower = image_tower(self._clip, self._weights)
        example = np.random.default_rng(0).integers(0, 256, (1, self.input_px, self.input_px, 3), np.uint8)
        export(tower, example, out, "image", ["tokens", "embedding"])


class ClipTextEncoder:
    """Tokenizer and text tower of a CLIP folder; `cached` is the prefix of the exported tower's name."""

    def __init__(self, folder: Path, cached: str) -> None:
        self._clip, self._weights = read_folder(folder)
        self._tokenizer, self._end = read_tokenizer(folder, self._clip)
        self._session: onnxruntime.InferenceSession = cached_session(f"{cached}-text-{self._end}", self._build)

    def embed(self, texts: list[str]) -> np.ndarray:
        """Return embeddings `(N, D)` float32 of texts, of unit length."""
        return run_text_tower(self._tokenizer, self._session, texts)

    def _build(self, out: Path) -> None:
        """Export the text tower and check it against torch."""
        import torch

        from zsdist.vision.encoders.clip_towers import text_tower

        with torch.random.fork_rng():
            tower = text_tower(self._clip, self._weights, self._end)
        export(tower, np.array([[0, 1, self._end], [0, self._end, 1]]), out, "ids", ["embedding"], ("batch", "length"))
