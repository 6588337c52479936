"""Encoded pictures with their truth, and batches of them with labels."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from zsdist.vision.labels import nearest, openness, progress, random_goals, reward_label
from zsdist.vision.rays import RANGE_M, soft_labels


@dataclass(frozen=True)
class Examples:
    """Encoded views with their truth.

    Attributes:
        tokens: `(N, side, side, features)` float16, tokens of the pictures.
        ray_distance_m: `(N, R)` float32, true distances, capped at the camera's range.
        ray_dynamic: `(N, R)` bool, whether the ray meets an object of a kind that moves.
        ray_angles_rad: `(R,)` float32, angles of the rays, left positive.
        images: `(N, 128, 128, 3)` uint8, the pictures resampled for the student network; None: not kept.
    """

    tokens: np.ndarray
    ray_distance_m: np.ndarray
    ray_dynamic: np.ndarray
    ray_angles_rad: np.ndarray
    images: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.tokens)


def token_spread(tokens: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation of each feature, both `(features,)` float32, over about 500 pictures.

    Args:
        tokens: `(N, side, side, features)`; may be mapped from disk.
    """
    some = tokens[:: max(1, len(tokens) // 500)].astype(np.float32)
    return some.mean((0, 1, 2)), some.std((0, 1, 2))


@dataclass(frozen=True)
class Targets:
    """Batch with its labels, as tensors; shapes as in `VisualActHead.forward`."""

    tokens: torch.Tensor
    rays: torch.Tensor
    clearance: torch.Tensor
    dynamic: torch.Tensor
    present: torch.Tensor
    goal_distance_m: torch.Tensor
    progress: torch.Tensor
    reward: torch.Tensor


def targets(
    examples: Examples,
    index: np.ndarray,
    mirrored: np.ndarray,
    rng: np.random.Generator,
    labels: Callable[[np.ndarray], np.ndarray] = soft_labels,
) -> Targets:
    """Return the views `index` `(B,)` with labels and random goals; they are mirrored where `mirrored` `(B,)` is true.

    The tokens of a mirrored image are nearly the mirrored tokens, so no image needs to be encoded twice.
    """
    tokens = examples.tokens[index].astype(np.float32)
    tokens[mirrored] = tokens[mirrored][:, :, ::-1]
    distance = examples.ray_distance_m[index]
    distance[mirrored] = distance[mirrored][:, ::-1]
    moving = examples.ray_dynamic[index]
    moving[mirrored] = moving[mirrored][:, ::-1]
    clearance_m, dynamic = nearest(distance, moving, examples.ray_angles_rad)
    bearing, goal_distance = random_goals(len(index), rng)
    gain = progress(bearing, goal_distance)
    reward = reward_label(openness(clearance_m, dynamic, goal_distance[:, None]), gain).astype(np.float32)
    parts = (
        tokens,
        labels(distance),
        labels(clearance_m),
        dynamic.astype(np.float32),
        clearance_m < RANGE_M,
        goal_distance,
        gain,
        reward,
    )
    return Targets(*(torch.from_numpy(part) for part in parts))
