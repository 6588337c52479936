"""Compact network that reads pictures without an encoder: the outputs of the head at a fraction of its cost."""

import math

import torch
from torch import Tensor, nn

from zsdist.vision.models import COMPACT_PX, COMPACT_ROWS
from zsdist.vision.models.head import ACTIONS, HeadOutput, Residual1d, attention
from zsdist.vision.models.student import allowed_columns
from zsdist.vision.rays import BINS, RAYS

LEVELS = 64.0  # spread of a usual picture, in levels of 255
PATCH_PX = COMPACT_PX // RAYS  # side of a patch


class Residual2d(nn.Module):
    """Two dense 3 x 3 convolutions, added to their input."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.Conv2d(features, features, 3, padding=1, bias=False),
            nn.BatchNorm2d(features),
            nn.ReLU(),
            nn.Conv2d(features, features, 3, padding=1, bias=False),
            nn.BatchNorm2d(features),
        )

    def forward(self, x: Tensor) -> Tensor:
        """Return the block's output, of the shape of its input `(B, features, rows, columns)`."""
        return torch.relu(x + self.convolutions(x))


class Compact(nn.Module):
    """Network from pictures to the outputs that `VisualActHead` gives for tokens.

    Square patches, one column of them for each ray, become features. Dense convolutions then halve the height twice
    and keep the width: they do more multiply-adds a second on a processor than other kinds. The remaining height
    becomes the features of a column.

    Args:
        field_of_view_rad: field of view of the camera, which determines the columns of each direction.
        channels: numbers of features of the patches, and of the maps of half and of a quarter of their height.
        column_width: number of features of a column.
    """

    allowed: Tensor
    clearance_temperature: Tensor
    rays_temperature: Tensor

    def __init__(
        self, field_of_view_rad: float, channels: tuple[int, int, int] = (48, 48, 64), column_width: int = 96
    ) -> None:
        super().__init__()
        first, second, third = channels
        rows = math.ceil(math.ceil(COMPACT_ROWS / PATCH_PX / 2) / 2)
        self.trunk = nn.Sequential(
            *_convolution(3, first, PATCH_PX, PATCH_PX, 0),
            *_convolution(first, second, 3, (2, 1), 1),
            Residual2d(second),
            *_convolution(second, third, 3, (2, 1), 1),
            Residual2d(third),
        )
        self.fold = nn.Conv1d(third * rows, column_width, 1)
        self.context = nn.Linear(column_width, column_width)
        self.columns = nn.Sequential(Residual1d(column_width), Residual1d(column_width))
        self.ray_bins = nn.Conv1d(column_width, BINS, 1)
        self.queries = nn.Parameter(column_width**-0.5 * torch.randn(ACTIONS, column_width))
        self.keys = nn.Linear(column_width, column_width)
        self.action_networks = nn.ModuleList(
            nn.Sequential(nn.Linear(2 * column_width, column_width), nn.ReLU(), nn.Linear(column_width, BINS + 1))
            for _ in range(ACTIONS)
        )
        # divisors of the logits; `training.calibration` fits them after the training
        self.register_buffer("clearance_temperature", torch.ones(()))
        self.register_buffer("rays_temperature", torch.ones(()))
        self.register_buffer("allowed", allowed_columns(field_of_view_rad), persistent=False)

    def forward(self, images: Tensor) -> HeadOutput:
        """Return the output for pictures `(B, COMPACT_PX, COMPACT_PX, 3)` or their lowest rows, levels of 0 to 255.

        The attention `(B, 3, RAYS)` is over columns.
        """
        x = self.trunk((images[:, -COMPACT_ROWS:].permute(0, 3, 1, 2).float() - 127) / LEVELS)
        columns = self.fold(x.flatten(1, 2))
        columns = torch.relu(columns + self.context(columns.mean(2))[..., None])
        columns = self.columns(columns)
        each = columns.transpose(1, 2)
        attended, weights = attention(self.queries, self.keys(each), each, self.allowed)
        attended = torch.cat([attended, each.mean(1, keepdim=True).expand(-1, ACTIONS, -1)], -1)
        actions = torch.stack([network(attended[:, a]) for a, network in enumerate(self.action_networks)], 1)
        return HeadOutput(actions[..., :BINS], actions[..., BINS], self.ray_bins(columns).transpose(1, 2), weights)


def _convolution(before: int, after: int, kernel: int, stride: int | tuple[int, int], padding: int) -> list[nn.Module]:
    return [nn.Conv2d(before, after, kernel, stride, padding, bias=False), nn.BatchNorm2d(after), nn.ReLU()]
