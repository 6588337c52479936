"""Place of the arena, the square that the policy's map covers, in the frame of a robot's odometry."""

import math
from typing import NamedTuple, Self

from zsdist.errors import RunError
from zsdist.planning.grid import Grid
from zsdist.types import Pose

AT_ORIGIN_M = 0.05  # an odometry that begins within this distance of zero, and within this angle, has its origin there
AT_ORIGIN_RAD = math.radians(3.0)
MARGIN_M = 1.25  # start and goal are at least so far inside the grid, where the robot has room to turn


class ArenaFrame(NamedTuple):
    """Frame of the arena: its centre in the odometry's frame, and the same axes."""

    x_m: float = 0.0
    y_m: float = 0.0

    @classmethod
    def place(cls, start: Pose, goal: tuple[float, float], grid: Grid, centre: tuple[float, float] | None) -> Self:
        """Return the arena for a drive.

        A given centre is taken as it is. An odometry that does not begin at zero has a frame of its own, such as that
        of a scene, and the arena lies around its origin. One that begins at zero says nothing but that the robot stands
        there: the arena lies around the middle of start and goal, so that the robot stands on the centre of a cell.

        Args:
            start: pose of the robot, in the odometry's frame.
            goal: goal, in the same frame.
            grid: planning grid.
            centre: given centre; None: it is chosen.

        Raises:
            RunError: start or goal does not fit onto the grid.
        """
        if centre is not None:
            frame = cls(*centre)
        elif math.hypot(start.x_m, start.y_m) > AT_ORIGIN_M or abs(start.heading_rad) > AT_ORIGIN_RAD:
            frame = cls()
        else:
            middle = (round(goal[0] / 2 / grid.cell_size_m), round(goal[1] / 2 / grid.cell_size_m))
            frame = cls(*((cells + 0.5) * grid.cell_size_m + at for cells, at in zip(middle, start, strict=False)))
        frame._check("start", start.x_m, start.y_m, grid)
        frame.check_goal(goal, grid)
        return frame

    def check_goal(self, goal: tuple[float, float], grid: Grid) -> None:
        """Raise `RunError` where a goal in the odometry's frame does not fit onto the grid."""
        self._check("goal", *goal, grid)

    def pose(self, odometry: Pose) -> Pose:
        """Return a pose of the odometry in the frame of the arena."""
        return Pose(odometry.x_m - self.x_m, odometry.y_m - self.y_m, odometry.heading_rad)

    def point(self, odometry: tuple[float, float]) -> tuple[float, float]:
        """Return a point of the odometry's frame in the frame of the arena."""
        return odometry[0] - self.x_m, odometry[1] - self.y_m

    def _check(self, what: str, x_m: float, y_m: float, grid: Grid) -> None:
        half = grid.side_m / 2
        x, y = x_m - self.x_m, y_m - self.y_m
        if not max(abs(x), abs(y)) <= half:
            ranges = (
                f"x {self.x_m - half:.2f} to {self.x_m + half:.2f}, y {self.y_m - half:.2f} to {self.y_m + half:.2f}"
            )
            raise RunError(
                f"{what} is ({x_m:.2f}, {y_m:.2f}) in the odometry's frame; the policy's map covers {ranges}; "
                "choose a nearer goal, or place the map with --arena X Y"
            )
