"""Small network that reads pictures without an encoder: gives the outputs of the head at a tenth of the cost."""

import numpy as np
import torch
from torch import Tensor, nn

from zsdist.vision.labels import sectors
from zsdist.vision.models import STUDENT_PX
from zsdist.vision.models.head import ACTIONS, HeadOutput, Residual1d, attention
from zsdist.vision.rays import BINS, RAYS, ray_angles_rad

LEVELS = 64.0  # spread of a usual picture, in levels of 255
MARGIN_COLUMNS = 3  # columns of the neighbouring directions that an action may also attend to


class Student(nn.Module):
    """Network from pictures to the outputs that `VisualActHead` gives for tokens.

    Four convolutions reduce the picture to one column per ray: all four halve the height, only the first two halve the
    width. The remaining height becomes the features of a column.

    Args:
        field_of_view_rad: field of view of the camera, which determines the columns of each direction.
        channels: numbers of output channels of the four convolutions.
        column_width: number of features of a column.
    """

    allowed: Tensor
    clearance_temperature: Tensor
    rays_temperature: Tensor

    def __init__(
        self,
        field_of_view_rad: float,
        channels: tuple[int, int, int, int] = (16, 32, 64, 96),
        column_width: int = 96,
    ) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        strides, before = ((2, 2), (2, 2), (2, 1), (2, 1)), 3
        for width, stride in zip(channels, strides, strict=True):
            layers += [nn.Conv2d(before, width, 3, stride, padding=1, bias=False), nn.BatchNorm2d(width), nn.ReLU()]
            before = width
        self.trunk = nn.Sequential(*layers)
        self.fold = nn.Conv1d(before * STUDENT_PX // 16, column_width, 1)
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
        """Return the output for pictures `(B, 128, 128, 3)`, 0 to 255; the attention `(B, 3, RAYS)` is over columns."""
        x = self.trunk((images.permute(0, 3, 1, 2).float() - 127) / LEVELS)
        columns = self.fold(x.flatten(1, 2))
        columns = torch.relu(columns + self.context(columns.mean(2))[..., None])
        columns = self.columns(columns)
        each = columns.transpose(1, 2)
        attended, weights = attention(self.queries, self.keys(each), each, self.allowed)
        attended = torch.cat([attended, each.mean(1, keepdim=True).expand(-1, ACTIONS, -1)], -1)
        actions = torch.stack([network(attended[:, a]) for a, network in enumerate(self.action_networks)], 1)
        return HeadOutput(actions[..., :BINS], actions[..., BINS], self.ray_bins(columns).transpose(1, 2), weights)


def allowed_columns(field_of_view_rad: float) -> Tensor:
    """Return the columns that each action may attend to, `(3, RAYS)` bool."""
    own = sectors(ray_angles_rad(RAYS, field_of_view_rad))
    near = np.abs(np.arange(RAYS)[:, None] - np.arange(RAYS)) <= MARGIN_COLUMNS
    return torch.from_numpy((own[:, None] & near).any(-1))
