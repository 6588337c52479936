"""Compact network that reads pictures without an encoder: the outputs of the head at a fraction of its cost."""

import math

import torch
from torch import Tensor, nn

from zsdist.vision.models import COMPACT_PX, COMPACT_ROWS
from zsdist.vision.models.columns import ColumnNetwork, convolution
from zsdist.vision.models.head import HeadOutput
from zsdist.vision.rays import RAYS

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


class Compact(ColumnNetwork):
    """Network for pictures `(B, COMPACT_PX, COMPACT_PX, 3)` or their lowest rows.

    Square patches, one column of them for each ray, become features. Dense convolutions then halve the height twice
    and keep the width: they do more multiply-adds a second on a processor than other kinds. The remaining height
    becomes the features of a column.

    Args:
        field_of_view_rad: field of view of the camera, which determines the columns of each direction.
        channels: numbers of features of the patches, and of the maps of half and of a quarter of their height.
        column_width: number of features of a column.
    """

    def __init__(
        self, field_of_view_rad: float, channels: tuple[int, int, int] = (48, 48, 64), column_width: int = 96
    ) -> None:
        first, second, third = channels
        rows = math.ceil(math.ceil(COMPACT_ROWS / PATCH_PX / 2) / 2)
        trunk = nn.Sequential(
            *convolution(3, first, PATCH_PX, PATCH_PX, 0),
            *convolution(first, second, 3, (2, 1), 1),
            Residual2d(second),
            *convolution(second, third, 3, (2, 1), 1),
            Residual2d(third),
        )
        super().__init__(trunk, third * rows, column_width, field_of_view_rad)

    def forward(self, images: Tensor) -> HeadOutput:
        """Return the output for the lowest rows; see `ColumnNetwork.forward`."""
        return super().forward(images[:, -COMPACT_ROWS:])
