"""The visual-act model as the car uses it: an image and the goal's direction in, a `View` out; no torch needed."""

import json
from pathlib import Path
from typing import Any, Self

import numpy as np

from zsdist.config import CameraConfig, VisionConfig
from zsdist.errors import WeightsError
from zsdist.types import View
from zsdist.vision.encoders.base import Encoder
from zsdist.vision.encoders.lite0 import EfficientNetLite0
from zsdist.vision.exported import cached_session, export, file_sha256
from zsdist.vision.labels import expected_openness, progress, reward_label
from zsdist.vision.rays import BIN_CENTRES_M, BIN_EDGES_M, RAYS, quantile_m, ray_angles_rad

WEIGHTS_FILE = "visual_act.safetensors"
METADATA_FILE = "visual_act.json"
SHIPPED = Path(__file__).parent / "weights"
CAMERA_KEYS = ("field_of_view_deg", "range_m", "height_m")
"""Settings of the camera that a head is trained for and that it cannot do without."""


class VisualAct:
    """Encoder and head. Use `VisualAct.load`.

    Attributes:
        encoder_name: name of the encoder.
        weights_sha256: SHA-256 of the head's weights file, hexadecimal.
    """

    def __init__(self, encoder: Encoder, folder: Path, metadata: dict[str, Any], ray_quantile: float) -> None:
        path = folder / WEIGHTS_FILE
        self.encoder_name = encoder.name
        self.weights_sha256 = file_sha256(path)
        if self.weights_sha256 != metadata["sha256"]:
            raise WeightsError(
                f"weights {path} are damaged: SHA-256 {self.weights_sha256[:16]}..., "
                f"allowed is {str(metadata['sha256'])[:16]}... of {METADATA_FILE}"
            )
        field_of_view_rad = np.radians(metadata["camera"]["field_of_view_deg"])
        self._encoder = encoder
        self._quantile = ray_quantile
        self._angles = ray_angles_rad(RAYS, field_of_view_rad)
        self._session = cached_session(
            f"visual-act-{self.weights_sha256[:16]}", lambda out: _build(path, field_of_view_rad, out)
        )

    @classmethod
    def load(cls, config: VisionConfig, camera: CameraConfig) -> Self:
        """The model of `config.weights`: "pretrained" (shipped) or a folder that `zsdist.pretrain` made.

        Raises:
            WeightsError: weights are missing, damaged, or made for another encoder or camera.
        """
        folder = SHIPPED if config.weights == "pretrained" else Path(config.weights)
        metadata = read_metadata(folder)
        encoder = EfficientNetLite0()
        for key, found in (("name", encoder.name), ("sha256", encoder.sha256)):
            if metadata["encoder"][key] != found:
                raise WeightsError(
                    f"weights {folder / WEIGHTS_FILE} are for an encoder of {key} {metadata['encoder'][key]!r}; "
                    f"the one here has {found!r}"
                )
        for key in CAMERA_KEYS:
            if metadata["camera"][key] != getattr(camera, key):
                raise WeightsError(
                    f"camera.{key} is {getattr(camera, key)}; weights {folder / WEIGHTS_FILE} allow "
                    f"{metadata['camera'][key]}, others are made by `python -m zsdist.pretrain`"
                )
        return cls(encoder, folder, metadata, config.ray_quantile)

    def __call__(self, images: np.ndarray, goal_bearing_rad: np.ndarray, goal_distance_m: np.ndarray) -> list[View]:
        """What is seen on each image.

        Args:
            images: `(B, px, px, 3)` uint8.
            goal_bearing_rad: `(B,)` direction of the goal from the car's heading, left positive.
            goal_distance_m: `(B,)`.

        Raises:
            ValueError: the images are no such array, or the goals are not one an image.
        """
        bearing, distance = np.asarray(goal_bearing_rad, np.float32), np.asarray(goal_distance_m, np.float32)
        if bearing.shape != (len(images),) or distance.shape != (len(images),):
            raise ValueError(
                f"goal bearings are {bearing.shape} and distances {distance.shape}; allowed is ({len(images)},), "
                "one an image"
            )
        clearance, dynamic, rays = self.read(images)
        advice = reward_label(
            expected_openness(clearance, BIN_CENTRES_M, dynamic, distance), progress(bearing, distance)
        ).astype(np.float32)
        clearance_m = quantile_m(clearance, self._quantile)
        return [
            View(advice[i], clearance_m[i], dynamic[i], rays[i], self._angles, BIN_EDGES_M) for i in range(len(images))
        ]

    def read(self, images: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distributions of the clearance `(B, 3, K)`, probabilities of "dynamic" `(B, 3)`, of the rays `(B, R, K)`."""
        return tuple(self._session.run(["clearance", "dynamic", "rays"], {"tokens": self._encoder.tokens(images)}))


def read_metadata(folder: Path) -> dict[str, Any]:
    """What a folder of weights says of itself; raises `WeightsError` where it is missing or says too little."""
    path = folder / METADATA_FILE
    try:
        metadata = json.loads(path.read_text())
    except OSError as error:
        raise WeightsError(
            f"weights {path} cannot be read: {error.strerror or error}; allowed are 'pretrained' and a folder "
            "made by `python -m zsdist.pretrain`"
        ) from error
    except ValueError as error:
        raise WeightsError(f"weights {path} is damaged: {error}") from error
    try:
        _ = metadata["sha256"], metadata["encoder"]["name"], metadata["encoder"]["sha256"]
        _ = [float(metadata["camera"][key]) for key in CAMERA_KEYS]
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsError(f"weights {path} is damaged: no usable entry {error}") from error
    return metadata


def _build(weights: Path, field_of_view_rad: float, out: Path) -> None:
    """Exports the head and checks it against torch."""
    import safetensors
    import safetensors.torch

    from zsdist.vision.encoders.lite0 import FEATURES, SIDE
    from zsdist.vision.models.head import Probabilities, VisualActHead

    head = VisualActHead(FEATURES, SIDE, field_of_view_rad)
    try:
        head.load_state_dict(safetensors.torch.load_file(weights))
    except (safetensors.SafetensorError, RuntimeError, OSError) as error:
        raise WeightsError(
            f"weights {weights} are not those of a head: {' '.join(str(error).split())[:200]}"
        ) from error
    example = np.random.default_rng(0).normal(size=(2, SIDE, SIDE, FEATURES)).astype(np.float32)
    export(Probabilities(head), example, out, "tokens", ["clearance", "dynamic", "rays"])
