"""Visual-act model for use on the car: from images and the goal to a `View`; no torch needed."""

import hashlib
from collections.abc import Callable
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Self, TypeVar

import numpy as np
import onnxruntime

from zsdist.common import folders
from zsdist.config import CameraConfig, VisionConfig
from zsdist.errors import WeightsError
from zsdist.types import View
from zsdist.vision import weights_folder
from zsdist.vision.encoders import open_encoder
from zsdist.vision.encoders.base import Encoder, check_images, resample
from zsdist.vision.exported import cached_session, export
from zsdist.vision.models import COMPACT_PX, STUDENT_PX
from zsdist.vision.reading import READING_OUTPUTS, Reading, Views
from zsdist.vision.weights_folder import COMPACT_FILE, HEAD_FILE, PROJECTION_FILE, STUDENT_FILE, WeightsFolder

if TYPE_CHECKING:
    import torch

    from zsdist.vision.models.head import VisualActHead

Made = TypeVar("Made")

ALONE = {"student": (STUDENT_FILE, STUDENT_PX), "compact": (COMPACT_FILE, COMPACT_PX)}
"""File of weights and side of the pictures of each network that needs no encoder, by its name in `vision.network`."""

OBSERVATION_OUTPUTS = ["attention", "embeddings"]


class Observation(NamedTuple):
    """Attention of the head on B images, and embeddings of the attended parts in text space.

    Attributes:
        attention: `(B, 3, side * side)`, attention of the actions forward, left and right; each sums to 1.
        embeddings: `(B, 4, D)`, unit vectors: I_0 of the whole image, I_1 to I_3 under each action's attention.
    """

    attention: np.ndarray
    embeddings: np.ndarray


class VisualAct:
    """Encoder and head, or a network that needs no encoder. Use `VisualAct.load`.

    Encoder and head are opened when something asks for them: at once where they read the pictures, else for attention
    and words.

    The three attributes below identify the vision model that a policy is trained with. A network without an encoder is
    its own encoder: its name is that of the network, and both hashes are those of its weights.

    Args:
        weights: folder of weights; a file is read when it is needed.
        config: network, encoder, quantile to which a distribution of the clearance is reduced, and device for readings.

    Attributes:
        encoder_name: name of the encoder.
        encoder_sha256: SHA-256 of the encoder's weights, hexadecimal.
        weights_sha256: SHA-256 of the weights file of the network, hexadecimal.

    Raises:
        WeightsError: weights are missing, damaged, or of another network or encoder.
        ConfigError: the device is a GPU, and none can be used.
    """

    def __init__(self, weights: WeightsFolder, config: VisionConfig) -> None:
        self._weights, self._network, self._spec = weights, config.network, config.encoder
        self._alone = config.network != "head"
        file, self._px = ALONE.get(config.network, (HEAD_FILE, 0))
        self.encoder_name = config.network if self._alone else self._encoder.name
        content = weights.content(file)
        self.weights_sha256 = weights.sha256(file)
        self.encoder_sha256 = self.weights_sha256 if self._alone else self._encoder.sha256
        self._views = Views(config.ray_quantile, _field_of_view_rad(weights))
        self._session = cached_session(
            f"{Path(file).stem}-{self.weights_sha256[:16]}-{_code()}",
            partial(_build_alone, weights, content, config.network)
            if self._alone
            else partial(_build_head, weights, content, self._encoder),
            config.device,
        )

    @classmethod
    def load(cls, config: VisionConfig, camera: CameraConfig) -> Self:
        """Return the model of `config.weights`: "pretrained" (shipped) or a folder that `zsdist.pretrain` made.

        Raises:
            WeightsError: weights are missing, damaged, or made for another encoder or camera.
        """
        weights = weights_folder.read(weights_folder.locate(config.weights))
        weights.check_camera(camera)
        return cls(weights, config)

    def __call__(self, images: np.ndarray, goal_bearing_rad: np.ndarray, goal_distance_m: np.ndarray) -> list[View]:
        """Return the view of each image.

        Args:
            images: `(B, px, px, 3)` uint8.
            goal_bearing_rad: `(B,)` direction of the goal from the car's heading, left positive.
            goal_distance_m: `(B,)`, distance to the goal.

        Raises:
            ImageError: `images` has another shape or dtype.
            ValueError: the number of goals is not that of images.
        """
        return self.views(self.read(images), goal_bearing_rad, goal_distance_m)

    def views(self, reading: Reading, goal_bearing_rad: np.ndarray, goal_distance_m: np.ndarray) -> list[View]:
        """Return views of a reading, with the advice R_p for the given goals; arguments as in `__call__`.

        Raises:
            ValueError: the number of goals is not that of images.
        """
        return self._views.of(reading, goal_bearing_rad, goal_distance_m)

    def read(self, images: np.ndarray) -> Reading:
        """Return the outputs of the model for images; they do not depend on the goal.

        Args:
            images: `(B, px, px, 3)` uint8; they are resampled to the size of the network.

        Raises:
            ImageError: `images` has another shape or dtype.
        """
        if self._alone:
            check_images(images)
            return Reading(*self._session.run(READING_OUTPUTS, {"image": resample(images, self._px)}))
        return self.read_tokens(self._encoder.tokens(images))

    def read_tokens(self, tokens: np.ndarray) -> Reading:
        """Return the outputs of the head for tokens `(B, side, side, features)` float32 of the encoder.

        Raises:
            WeightsError: the network has no encoder.
        """
        if self._alone:
            raise WeightsError(f"vision.network is {self._network!r}, which reads no tokens; allowed is 'head'")
        return Reading(*self._session.run(READING_OUTPUTS, {"tokens": tokens}))

    @property
    def network_files(self) -> list[Path]:
        """Exported networks that read a picture, in order: encoder and head, or one network alone."""
        return [self._session.path] if self._alone else [self._encoder.network_file, self._session.path]

    def observe(self, images: np.ndarray) -> Observation:
        """Return attention and embeddings of images `(B, px, px, 3)` uint8, always by encoder and head.

        They are opened at first use.

        Raises:
            ImageError: `images` has another shape or dtype.
            WeightsError: the encoder is another one than that of the weights; or head or projection are missing from
                the folder or damaged.
        """
        return Observation(*self._attention_session.run(OBSERVATION_OUTPUTS, {"tokens": self._encoder.tokens(images)}))

    @cached_property
    def _encoder(self) -> Encoder:
        encoder = open_encoder(self._spec)
        self._weights.check_encoder(encoder)
        return encoder

    @cached_property
    def _attention_session(self) -> onnxruntime.InferenceSession:
        weights, encoder = self._weights, self._encoder
        native, head = encoder.native_projection(), weights.content(HEAD_FILE)
        projection: bytes | dict[str, np.ndarray]
        if weights.has(PROJECTION_FILE) or native is None:
            projection, projection_sha256 = weights.content(PROJECTION_FILE), weights.sha256(PROJECTION_FILE)
        else:
            projection, projection_sha256 = native, encoder.sha256
        return cached_session(
            f"looking-{weights.sha256(HEAD_FILE)[:16]}-{projection_sha256[:16]}-{_code()}",
            lambda out: _build_attention_reader(weights, head, projection, encoder, out),
        )


def _code() -> str:
    """Return a short hash of the networks' source files, since the same weights in other code are another network."""
    here = Path(__file__).parent
    sources = (*folders.visible(here / "models", "*.py"), here / "labels.py", here / "rays.py")
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:8]


def _field_of_view_rad(weights: WeightsFolder) -> float:
    return float(np.radians(weights.metadata["camera"]["field_of_view_deg"]))


def _build_alone(weights: WeightsFolder, content: bytes, network: str, out: Path) -> None:
    """Export a network that needs no encoder with probabilities as outputs, and check it against torch."""
    from zsdist.vision.models.compact import Compact
    from zsdist.vision.models.head import Probabilities
    from zsdist.vision.models.student import Student

    file, px = ALONE[network]
    field_of_view_rad = _field_of_view_rad(weights)
    module: Student | Compact = Student(field_of_view_rad) if network == "student" else Compact(field_of_view_rad)
    _parse(module.load_state_dict, content, weights.path / file)
    images = np.random.default_rng(0).integers(0, 256, (2, px, px, 3), np.uint8)
    export(Probabilities(module), images, out, "image", READING_OUTPUTS)


def _build_head(weights: WeightsFolder, content: bytes, encoder: Encoder, out: Path) -> None:
    """Export the head with probabilities as outputs, and check it against torch."""
    from zsdist.vision.models.head import Probabilities

    head = _load_head(weights, content, encoder)
    export(Probabilities(head), _example_tokens(encoder), out, "tokens", READING_OUTPUTS)


def _build_attention_reader(
    weights: WeightsFolder, head: bytes, projection: bytes | dict[str, np.ndarray], encoder: Encoder, out: Path
) -> None:
    """Export head and projection as one network, and check it against torch."""
    import torch

    from zsdist.vision.models.attention_reader import AttentionReader
    from zsdist.vision.models.projection import projection_of

    projected: torch.nn.Module
    if isinstance(projection, bytes):
        projected = _parse(projection_of, projection, weights.path / PROJECTION_FILE)
    else:
        width, features = projection["weight"].shape
        projected = torch.nn.Linear(features, width)
        projected.load_state_dict({name: torch.from_numpy(value) for name, value in projection.items()})
    reader = AttentionReader(_load_head(weights, head, encoder), projected)
    export(reader, _example_tokens(encoder), out, "tokens", OBSERVATION_OUTPUTS)


def _load_head(weights: WeightsFolder, content: bytes, encoder: Encoder) -> "VisualActHead":
    from zsdist.vision.models.head import VisualActHead

    head = VisualActHead(encoder.features, encoder.side, _field_of_view_rad(weights))
    _parse(head.load_state_dict, content, weights.path / HEAD_FILE)
    return head


def _parse(make: Callable[[dict[str, "torch.Tensor"]], Made], content: bytes, path: Path) -> Made:
    """Return the result of `make` on the tensors of a file; raise `WeightsError` if some are missing or left over."""
    import safetensors
    import safetensors.torch

    try:
        return make(safetensors.torch.load(content))
    except (safetensors.SafetensorError, KeyError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise WeightsError(f"weights {path} are not those of a {path.stem}: {reason}") from error


def _example_tokens(encoder: Encoder) -> np.ndarray:
    shape = (2, encoder.side, encoder.side, encoder.features)
    return np.random.default_rng(0).normal(size=shape).astype(np.float32)
