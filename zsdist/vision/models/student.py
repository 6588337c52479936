"""Small network that reads pictures without an encoder: gives the outputs of the head at a tenth of the cost."""

from torch import nn

from zsdist.vision.models import STUDENT_PX
from zsdist.vision.models.columns import ColumnNetwork, convolution


class Student(ColumnNetwork):
    """Network for pictures `(B, STUDENT_PX, STUDENT_PX, 3)`.

    Four convolutions reduce the picture to one column per ray: all four halve the height, only the first two halve the
    width. The remaining height becomes the features of a column.

    Args:
        field_of_view_rad: field of view of the camera, which determines the columns of each direction.
        channels: numbers of output channels of the four convolutions.
        column_width: number of features of a column.
    """

    def __init__(
        self,
        field_of_view_rad: float,
        channels: tuple[int, int, int, int] = (16, 32, 64, 96),
        column_width: int = 96,
    ) -> None:
        layers: list[nn.Module] = []
        strides, before = ((2, 2), (2, 2), (2, 1), (2, 1)), 3
        for width, stride in zip(channels, strides, strict=True):
            layers += convolution(before, width, 3, stride, 1)
            before = width
        super().__init__(nn.Sequential(*layers), before * STUDENT_PX // 16, column_width, field_of_view_rad)
