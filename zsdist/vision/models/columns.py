"""Second half of the networks that read pictures without an encoder: from a column of features for each ray on."""

import numpy as np
import torch
from torch import Tensor, nn

from zsdist.vision.labels import sectors
from zsdist.vision.models.head import ACTIONS, HeadOutput, Residual1d, attention
from zsdist.vision.rays import BINS, RAYS, ray_angles_rad

LEVELS = 64.0  # spread of a usual picture, in levels of 255
MARGIN_COLUMNS = 3  # columns of the neighbouring directions that an action may also attend to


class ColumnNetwork(nn.Module):
    """Network from pictures to the outputs that `VisualActHead` gives for tokens.

    Args:
        trunk: convolutions from pictures `(B, 3, rows, columns)` to maps with one column for each ray.
        features: number of features of a column of these maps, over all of their height.
        column_width: number of features of a column after that.
        field_of_view_rad: field of view of the camera, which determines the columns of each direction.
    """

    allowed: Tensor
    clearance_temperature: Tensor
    rays_temperature: Tensor

    def __init__(self, trunk: nn.Sequential, features: int, column_width: int, field_of_view_rad: float) -> None:
        super().__init__()
        self.trunk = trunk
        self.fold = nn.Conv1d(features, column_width, 1)
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
        """Return the output for pictures `(B, rows, columns, 3)`, levels of 0 to 255.

        The attention `(B, 3, RAYS)` is over columns.
        """
        x = self.trunk((images.permute(0, 3, 1, 2).float() - 127) / LEVELS)
        columns = self.fold(x.flatten(1, 2))
        columns = torch.relu(columns + self.context(columns.mean(2))[..., None])
        columns = self.columns(columns)
        each = columns.transpose(1, 2)
        attended, weights = attention(self.queries, self.keys(each), each, self.allowed)
        attended = torch.cat([attended, each.mean(1, keepdim=True).expand(-1, ACTIONS, -1)], -1)
        actions = torch.stack([network(attended[:, a]) for a, network in enumerate(self.action_networks)], 1)
        return HeadOutput(actions[..., :BINS], actions[..., BINS], self.ray_bins(columns).transpose(1, 2), weights)


def convolution(before: int, after: int, kernel: int, stride: int | tuple[int, int], padding: int) -> list[nn.Module]:
    """Return the layers of a convolution with normalised, rectified outputs."""
    return [nn.Conv2d(before, after, kernel, stride, padding, bias=False), nn.BatchNorm2d(after), nn.ReLU()]


def allowed_columns(field_of_view_rad: float) -> Tensor:
    """Return the columns that each action may attend to, `(3, RAYS)` bool."""
    own = sectors(ray_angles_rad(RAYS, field_of_view_rad))
    near = np.abs(np.arange(RAYS)[:, None] - np.arange(RAYS)) <= MARGIN_COLUMNS
    return torch.from_numpy((own[:, None] & near).any(-1))
