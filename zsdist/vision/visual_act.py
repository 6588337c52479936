"""The visual-act model as the car uses it: an image and the goal's direction in, a `View` out; no torch needed."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Self, TypeVar

import numpy as np
import onnxruntime

from zsdist.config import CameraConfig, VisionConfig
from zsdist.errors import WeightsError
from zsdist.types import View
from zsdist.vision import weights_folder
from zsdist.vision.encoders import open_encoder
from zsdist.vision.encoders.base import Encoder, check_images, resample
from zsdist.vision.exported import cached_session, export
from zsdist.vision.labels import expected_openness, progress, reward_label
from zsdist.vision.models import STUDENT_PX
from zsdist.vision.rays import BIN_CENTRES_M, BIN_EDGES_M, RAYS, quantile_m, ray_angles_rad
from zsdist.vision.weights_folder import HEAD_FILE, PROJECTION_FILE, STUDENT_FILE, WeightsFolder

if TYPE_CHECKING:
    import torch

Made = TypeVar("Made")

STUDENT_NAME = "student"
READ, LOOKED = ["clearance", "dynamic", "rays"], ["attention", "embeddings"]


class Reading(NamedTuple):
    """What B images show, whatever the goal.

    Attributes:
        clearance: `(B, 3, K)` distributions of the distance to the nearest obstacle forward, left and right.
        dynamic: `(B, 3)` probabilities that this obstacle is one that moves.
        rays: `(B, R, K)` distributions of the distance along each ray.
    """

    clearance: np.ndarray
    dynamic: np.ndarray
    rays: np.ndarray


class Observation(NamedTuple):
    """Where the head looked on B images, and what it found there, in the space of words.

    Attributes:
        attention: `(B, 3, side * side)` of the actions forward, left and right; each sums to 1.
        embeddings: `(B, 4, D)` of unit length: I_0 of the whole image, I_1 to I_3 of where each action looked.
    """

    attention: np.ndarray
    embeddings: np.ndarray


class VisualAct:
    """Encoder and head, or the student that needs no encoder. Use `VisualAct.load`.

    What a policy must find again to see as it learned to see is in the three names below. A student is its own
    encoder: its name is `STUDENT_NAME`, and both hashes are those of its weights.

    Args:
        weights: the folder; only the file of the network that is used is read.
        encoder: for the head; None: the student is used.
        ray_quantile: share of a distribution of distance below which the distance is taken to lie.

    Attributes:
        encoder_name: name of the encoder.
        encoder_sha256: SHA-256 of the encoder's weights, hexadecimal.
        weights_sha256: SHA-256 of the weights file of head or student, hexadecimal.

    Raises:
        WeightsError: weights are missing, damaged, or of another network.
    """

    def __init__(self, weights: WeightsFolder, encoder: Encoder | None, ray_quantile: float) -> None:
        file = STUDENT_FILE if encoder is None else HEAD_FILE
        content = weights.content(file)
        self.weights_sha256 = weights.sha256(file)
        self.encoder_name = STUDENT_NAME if encoder is None else encoder.name
        self.encoder_sha256 = self.weights_sha256 if encoder is None else encoder.sha256
        self._weights = weights
        self._encoder = encoder
        self._quantile = ray_quantile
        self._angles = ray_angles_rad(RAYS, _field_of_view_rad(weights))
        self._session = cached_session(
            f"{Path(file).stem}-{self.weights_sha256[:16]}-{_code()}",
            lambda out: _build(weights, content, encoder, out),
        )
        self._looking: onnxruntime.InferenceSession | None = None

    @classmethod
    def load(cls, config: VisionConfig, camera: CameraConfig) -> Self:
        """The model of `config.weights`: "pretrained" (shipped) or a folder that `zsdist.pretrain` made.

        Raises:
            WeightsError: weights are missing, damaged, or made for another encoder or camera.
        """
        weights = weights_folder.read(weights_folder.locate(config.weights))
        weights.check_camera(camera)
        if config.network == "student":
            return cls(weights, None, config.ray_quantile)
        encoder = open_encoder(config.encoder)
        weights.check_encoder(encoder)
        return cls(weights, encoder, config.ray_quantile)

    def __call__(self, images: np.ndarray, goal_bearing_rad: np.ndarray, goal_distance_m: np.ndarray) -> list[View]:
        """What is seen on each image: `views` of `read`.

        Args:
            images: `(B, px, px, 3)` uint8.
            goal_bearing_rad: `(B,)` direction of the goal from the car's heading, left positive.
            goal_distance_m: `(B,)`.

        Raises:
            ImageError: the images are no such array.
            ValueError: the goals are not one an image.
        """
        return self.views(self.read(images), goal_bearing_rad, goal_distance_m)

    def views(self, reading: Reading, goal_bearing_rad: np.ndarray, goal_distance_m: np.ndarray) -> list[View]:
        """What was read, with the advice R_p for the goal at hand; arguments as above.

        Raises:
            ValueError: the goals are not one an image.
        """
        clearance, dynamic, rays = reading
        bearing, distance = np.asarray(goal_bearing_rad, np.float32), np.asarray(goal_distance_m, np.float32)
        if bearing.shape != (len(rays),) or distance.shape != (len(rays),):
            raise ValueError(
                f"goal bearings are {bearing.shape} and distances {distance.shape}; allowed is ({len(rays)},), "
                "one an image"
            )
        advice = reward_label(
            expected_openness(clearance, BIN_CENTRES_M, dynamic, distance), progress(bearing, distance)
        ).astype(np.float32)
        clearance_m = quantile_m(clearance, self._quantile)
        return [
            View(advice[i], clearance_m[i], dynamic[i], rays[i], self._angles, BIN_EDGES_M) for i in range(len(rays))
        ]

    def read(self, images: np.ndarray) -> Reading:
        """What images show, whatever the goal.

        Args:
            images: `(B, px, px, 3)` uint8; a network that takes another size gets them resampled.

        Raises:
            ImageError: the images are no such array.
        """
        if self._encoder is None:
            check_images(images)
            return Reading(*self._session.run(READ, {"image": resample(images, STUDENT_PX)}))
        return self.read_tokens(self._encoder.tokens(images))

    def read_tokens(self, tokens: np.ndarray) -> Reading:
        """The same of the encoder's tokens `(B, side, side, features)` float32, where they are at hand; the head only.

        Raises:
            WeightsError: this is the student.
        """
        if self._encoder is None:
            raise WeightsError("vision.network is 'student', which reads no tokens; allowed is 'head'")
        return Reading(*self._session.run(READ, {"tokens": tokens}))

    def observe(self, images: np.ndarray) -> Observation:
        """Where the head looks on images `(B, px, px, 3)` uint8; its network is opened when first asked for.

        Raises:
            ImageError: the images are no such array.
            WeightsError: this is the student, or the folder lacks the projection, or it is damaged.
        """
        if self._encoder is None:
            raise WeightsError("vision.network is 'student', which has no words for what it sees; allowed is 'head'")
        if self._looking is None:
            self._looking = self._open_looking(self._encoder)
        return Observation(*self._looking.run(LOOKED, {"tokens": self._encoder.tokens(images)}))

    def _open_looking(self, encoder: Encoder) -> onnxruntime.InferenceSession:
        weights, native = self._weights, encoder.native_projection()
        if weights.has(PROJECTION_FILE) or native is None:
            head, projection = weights.content(HEAD_FILE), weights.content(PROJECTION_FILE)
            of = weights.sha256(PROJECTION_FILE)
        else:
            head, projection, of = weights.content(HEAD_FILE), native, encoder.sha256
        return cached_session(
            f"looking-{self.weights_sha256[:16]}-{of[:16]}-{_code()}",
            lambda out: _build_looking(weights, head, projection, encoder, out),
        )


def _code() -> str:
    """A short hash of what the networks are written in: the same weights in other code are another network."""
    here = Path(__file__).parent
    sources = (*sorted((here / "models").glob("*.py")), here / "labels.py", here / "rays.py")
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:8]


def _field_of_view_rad(weights: WeightsFolder) -> float:
    return float(np.radians(weights.metadata["camera"]["field_of_view_deg"]))


def _build(weights: WeightsFolder, content: bytes, encoder: Encoder | None, out: Path) -> None:
    """Exports head or student as probabilities and checks it against torch."""
    from zsdist.vision.models.head import Probabilities
    from zsdist.vision.models.student import Student

    if encoder is None:
        student = _loaded(Student(_field_of_view_rad(weights)), content, weights.path / STUDENT_FILE)
        images = np.random.default_rng(0).integers(0, 256, (2, STUDENT_PX, STUDENT_PX, 3), np.uint8)
        export(Probabilities(student), images, out, "image", READ)
    else:
        export(Probabilities(_head(weights, content, encoder)), _some_tokens(encoder), out, "tokens", READ)


def _build_looking(
    weights: WeightsFolder, head: bytes, projection: bytes | dict[str, np.ndarray], encoder: Encoder, out: Path
) -> None:
    """Exports head and projection together and checks them against torch."""
    import torch

    from zsdist.vision.models.attention_reader import AttentionReader
    from zsdist.vision.models.projection import projection_of

    if isinstance(projection, bytes):
        projected = _parsed(projection_of, projection, weights.path / PROJECTION_FILE)
    else:
        width, features = projection["weight"].shape
        projected = torch.nn.Linear(features, width)
        projected.load_state_dict({name: torch.from_numpy(value) for name, value in projection.items()})
    export(AttentionReader(_head(weights, head, encoder), projected), _some_tokens(encoder), out, "tokens", LOOKED)


def _head(weights: WeightsFolder, content: bytes, encoder: Encoder) -> "torch.nn.Module":
    from zsdist.vision.models.head import VisualActHead

    head = VisualActHead(encoder.features, encoder.side, _field_of_view_rad(weights))
    return _loaded(head, content, weights.path / HEAD_FILE)


def _loaded(network: "torch.nn.Module", content: bytes, path: Path) -> "torch.nn.Module":
    """The network with the weights in a file's content; none may be missing or left over."""
    _parsed(network.load_state_dict, content, path)
    return network


def _parsed(make: Callable[[dict[str, "torch.Tensor"]], Made], content: bytes, path: Path) -> Made:
    """What `make` makes of the tensors in a file's content; `WeightsError` where they are not those it needs."""
    import safetensors
    import safetensors.torch

    try:
        return make(safetensors.torch.load(content))
    except (safetensors.SafetensorError, KeyError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise WeightsError(f"weights {path} are not those of a {path.stem}: {reason}") from error


def _some_tokens(encoder: Encoder) -> np.ndarray:
    shape = (2, encoder.side, encoder.side, encoder.features)
    return np.random.default_rng(0).normal(size=shape).astype(np.float32)
