"""Trained part of the visual-act model, in torch: action queries and camera rays on the tokens of an encoder."""

from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from zsdist.vision.labels import SECTOR_HALF_RAD
from zsdist.vision.rays import BINS, RAYS

ACTIONS = 3
MASK_MARGIN = 0  # token columns of the neighbouring directions that an action may also attend to; 2 blurs I_1 to I_3


class HeadOutput(NamedTuple):
    """Output of the head for a batch of images, for the actions forward, left and right.

    Attributes:
        clearance: `(B, 3, BINS)` logits of the distance to the nearest obstacle.
        dynamic: `(B, 3)` logits of that obstacle being of a kind that moves.
        rays: `(B, RAYS, BINS)` logits of the distance along each ray.
        attention: `(B, 3, side * side)`, attention of each action: the gaze of `ActionAttention`; each sums to 1.
    """

    clearance: Tensor
    dynamic: Tensor
    rays: Tensor
    attention: Tensor


def attention(queries: Tensor, keys: Tensor, values: Tensor, allowed: Tensor) -> tuple[Tensor, Tensor]:
    """Return masked attention, Eq. (4): `softmax(Q K^T / sqrt(d_k)) V`, with weight 0 where `allowed` is false.

    Args:
        queries: `(..., Q, d_k)`, Q.
        keys: `(..., T, d_k)`, K.
        values: `(..., T, d_v)`, V.
        allowed: `(Q, T)` bool, tokens that each query may attend to; at least one per row.

    Returns:
        The attended values `(..., Q, d_v)`, and the weights `(..., Q, T)`.
    """
    scores = queries @ keys.transpose(-1, -2) / keys.shape[-1] ** 0.5
    weights = scores.masked_fill(~allowed, float("-inf")).softmax(-1)
    return weights @ values, weights


class ActionAttention(nn.Module):
    """Multi-head attention with one learned query for each action, on tokens with a learned position.

    A query may attend only to the token columns of its action's direction and a margin, so that objects on the left
    cannot be confused with objects on the right.

    An additional head, the gaze, has queries and keys of the whole width. Only the gaze is trained by the contrast and
    the attention error, and its weights give I_1 to I_3. The other heads may attend to the ground, which indicates
    distance.
    """

    allowed: Tensor

    def __init__(self, features: int, side: int, heads: int, field_of_view_rad: float) -> None:
        super().__init__()
        self.heads = heads
        self.positions = nn.Parameter(0.02 * torch.randn(side * side, features))
        self.queries = nn.Parameter(features**-0.5 * torch.randn(ACTIONS, features))
        self.keys_values = nn.Linear(features, 2 * features)
        self.gaze = nn.Parameter(features**-0.5 * torch.randn(ACTIONS, features))
        self.gaze_keys = nn.Linear(features, features)
        self.register_buffer("allowed", _allowed(side, field_of_view_rad), persistent=False)

    def forward(self, tokens: Tensor) -> tuple[Tensor, Tensor]:
        """Return features of each action `(B, 3, 2 * features)` and its gaze `(B, 3, side * side)`.

        Args:
            tokens: `(B, side * side, features)`, tokens from the top left, row by row.
        """
        batch, count, features = tokens.shape
        placed = tokens + self.positions
        keys, values = self.keys_values(placed).chunk(2, -1)
        gazed, gaze = attention(self.gaze, self.gaze_keys(placed), values, self.allowed)
        keys = keys.reshape(batch, count, self.heads, -1).transpose(1, 2)
        values = values.reshape(batch, count, self.heads, -1).transpose(1, 2)
        queries = self.queries.reshape(ACTIONS, self.heads, -1).transpose(0, 1)
        mixed, _ = attention(queries, keys, values, self.allowed)
        return torch.cat([mixed.transpose(1, 2).reshape(batch, ACTIONS, features), gazed], -1), gaze


class Residual1d(nn.Module):
    """Two convolutions over the columns of the view, added to their input."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.Conv1d(features, features, 3, padding=1),
            nn.ReLU(),
            nn.Conv1d(features, features, 3, padding=1),
        )

    def forward(self, columns: Tensor) -> Tensor:
        """Return the block's output `(B, features, columns)` for an input of the same shape."""
        return torch.relu(columns + self.convolutions(columns))


class VisualActHead(nn.Module):
    """Head from tokens to the clearance and kind of the nearest obstacle per direction, and to distances along rays.

    Args:
        features: features of a token.
        side: tokens along a side of the image.
        field_of_view_rad: field of view of the camera, which determines the columns of each direction.
        width: features of a token inside the head.
        column_width: features of a column of the view inside the head.
        heads: number of attention heads besides the gaze.
    """

    mean: Tensor
    scale: Tensor
    spread: Tensor
    clearance_temperature: Tensor
    rays_temperature: Tensor

    def __init__(
        self,
        features: int,
        side: int,
        field_of_view_rad: float,
        width: int = 64,
        column_width: int = 96,
        heads: int = 4,
    ) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("scale", torch.ones(features))
        self.project = nn.Linear(features, width)
        self.mix = nn.Conv2d(width, width, 3, padding=1)
        self.attention = ActionAttention(width, side, heads, field_of_view_rad)
        # the action-specific networks O_a: clearance over the distance bins, and one more output for "dynamic"
        self.action_networks = nn.ModuleList(
            nn.Sequential(nn.Linear(3 * width, width), nn.ReLU(), nn.Linear(width, BINS + 1)) for _ in range(ACTIONS)
        )
        # the tokens of a column, from top to bottom, give the features of the column
        self.fold = nn.Linear(side * width, column_width)
        self.column_of_token = nn.Linear(column_width, width)
        self.register_buffer("spread", _spread(side, RAYS), persistent=False)
        self.context = nn.Linear(column_width, column_width)
        self.columns = nn.Sequential(Residual1d(column_width), Residual1d(column_width))
        self.ray_bins = nn.Conv1d(column_width, BINS, 1)
        # divisors of the logits; `training.calibration` fits them after the training
        self.register_buffer("clearance_temperature", torch.ones(()))
        self.register_buffer("rays_temperature", torch.ones(()))

    def normalise_to(self, mean: np.ndarray, deviation: np.ndarray) -> None:
        """Set the mean and standard deviation `(features,)` with which tokens are normalised."""
        self.mean.copy_(torch.from_numpy(mean))
        self.scale.copy_(1 / torch.from_numpy(np.maximum(deviation, 1e-6)))

    def forward(self, tokens: Tensor) -> HeadOutput:
        """Return the output of the head for tokens `(B, side, side, features)`."""
        batch, side = tokens.shape[:2]
        x = torch.relu(self.project((tokens - self.mean) * self.scale))
        x = torch.relu(x + self.mix(x.permute(0, 3, 1, 2)).permute(0, 2, 3, 1))
        columns = self.fold(x.transpose(1, 2).reshape(batch, side, -1))
        columns = torch.relu(columns + self.context(columns.mean(1, keepdim=True)))
        flat = (x + self.column_of_token(columns)[:, None]).reshape(batch, side * side, -1)
        mixed, weights = self.attention(flat)
        attended = torch.cat([mixed, flat.mean(1, keepdim=True).expand(-1, ACTIONS, -1)], -1)
        actions = torch.stack([network(attended[:, a]) for a, network in enumerate(self.action_networks)], 1)
        columns = self.columns((self.spread @ columns).transpose(1, 2))
        rays = self.ray_bins(columns).transpose(1, 2)
        return HeadOutput(actions[..., :BINS], actions[..., BINS], rays, weights)


class CalibratedNetwork(Protocol):
    """Network whose logits are divided by temperatures before they become probabilities: a head or a student."""

    clearance_temperature: Tensor
    rays_temperature: Tensor

    def __call__(self, tokens: Tensor) -> HeadOutput:
        """Return the logits for tokens, or for pictures if this is a student."""


class Probabilities(nn.Module):
    """Head or student with calibrated probabilities as outputs instead of logits."""

    def __init__(self, network: CalibratedNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, tokens: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return probabilities of clearance, dynamic and rays, in the shapes of `HeadOutput`."""
        clearance, dynamic, rays, _ = self.network(tokens)
        return (
            (clearance / self.network.clearance_temperature).softmax(-1),
            dynamic.sigmoid(),
            (rays / self.network.rays_temperature).softmax(-1),
        )


def _allowed(side: int, field_of_view_rad: float) -> Tensor:
    """Return the tokens that each action may attend to, `(3, side * side)` bool."""
    edge = np.tan(SECTOR_HALF_RAD) / np.tan(field_of_view_rad / 2)
    column = np.arange(side)
    left_of, right_of = (1 - edge) / 2 * side, (1 + edge) / 2 * side  # middle sector, in columns
    columns = np.stack(
        [
            (column + 1 > left_of - MASK_MARGIN) & (column < right_of + MASK_MARGIN),
            column < left_of + MASK_MARGIN,
            column + 1 > right_of - MASK_MARGIN,
        ]
    )
    return torch.from_numpy(np.tile(columns, (1, side)))


def _spread(side: int, rays: int) -> Tensor:
    """Return weights `(rays, side)` that interpolate token columns at ray columns, linear between their centres."""
    position = np.clip((np.arange(rays) + 0.5) * side / rays - 0.5, 0, side - 1)
    return torch.from_numpy(np.clip(1 - np.abs(position[:, None] - np.arange(side)), 0, None).astype(np.float32))
