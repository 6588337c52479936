"""The visual-act model as the car uses it: an image and the goal's direction in, a `View` out; no torch needed."""

from pathlib import Path
from typing import Self

import numpy as np

from zsdist.config import CameraConfig, VisionConfig
from zsdist.errors import WeightsError
from zsdist.types import View
from zsdist.vision import folder
from zsdist.vision.encoders import open_encoder
from zsdist.vision.encoders.base import Encoder
from zsdist.vision.exported import cached_session, export
from zsdist.vision.folder import HEAD_FILE, Folder
from zsdist.vision.labels import expected_openness, progress, reward_label
from zsdist.vision.rays import BIN_CENTRES_M, BIN_EDGES_M, RAYS, quantile_m, ray_angles_rad

OUTPUTS = ["clearance", "dynamic", "rays"]


class VisualAct:
    """Encoder and head. Use `VisualAct.load`.

    Attributes:
        encoder_name: name of the encoder.
        encoder_sha256: SHA-256 of the encoder's weights, hexadecimal.
        weights_sha256: SHA-256 of the head's weights file, hexadecimal.
    """

    def __init__(self, weights: Folder, encoder: Encoder, ray_quantile: float) -> None:
        content = weights.content(HEAD_FILE)
        self.encoder_name, self.encoder_sha256 = encoder.name, encoder.sha256
        self.weights_sha256 = weights.sha256(HEAD_FILE)
        field_of_view_rad = np.radians(weights.metadata["camera"]["field_of_view_deg"])
        self._encoder = encoder
        self._quantile = ray_quantile
        self._angles = ray_angles_rad(RAYS, field_of_view_rad)
        self._session = cached_session(
            f"head-{self.weights_sha256[:16]}", lambda out: _build_head(weights, content, encoder, out)
        )

    @classmethod
    def load(cls, config: VisionConfig, camera: CameraConfig) -> Self:
        """The model of `config.weights`: "pretrained" (shipped) or a folder that `zsdist.pretrain` made.

        Raises:
            WeightsError: weights are missing, damaged, or made for another encoder or camera.
        """
        weights = folder.read(folder.locate(config.weights))
        weights.check_camera(camera)
        encoder = open_encoder(config.encoder)
        weights.check_encoder(encoder)
        return cls(weights, encoder, config.ray_quantile)

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
        return tuple(self._session.run(OUTPUTS, {"tokens": self._encoder.tokens(images)}))


def _build_head(weights: Folder, content: bytes, encoder: Encoder, out: Path) -> None:
    """Exports the head and checks it against torch."""
    import safetensors
    import safetensors.torch

    from zsdist.vision.models.head import Probabilities, VisualActHead

    head = VisualActHead(encoder.features, encoder.side, np.radians(weights.metadata["camera"]["field_of_view_deg"]))
    try:
        head.load_state_dict(safetensors.torch.load(content))
    except (safetensors.SafetensorError, RuntimeError) as error:
        raise WeightsError(
            f"weights {weights.path / HEAD_FILE} are not those of a head: {' '.join(str(error).split())[:200]}"
        ) from error
    example = np.random.default_rng(0).normal(size=(2, encoder.side, encoder.side, encoder.features))
    export(Probabilities(head), example.astype(np.float32), out, "tokens", OUTPUTS)
