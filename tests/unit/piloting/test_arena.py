import math

import pytest

from zsdist.errors import RunError
from zsdist.piloting.arena import ArenaFrame
from zsdist.planning.grid import Grid
from zsdist.types import Pose

GRID = Grid()
ORIGIN = Pose(0.0, 0.0, 0.0)


def test_an_odometry_with_a_frame_of_its_own_keeps_it():
    assert ArenaFrame.place(Pose(-8.0, 3.0, 1.0), (8.0, 8.0), GRID, None) == (0.0, 0.0)


@pytest.mark.parametrize("goal", [(5.0, 0.0), (12.0, 3.0), (-14.0, 14.0), (0.4, -0.2)])
def test_a_robot_at_its_origin_stands_on_a_cell_and_the_goal_fits(goal):
    frame = ArenaFrame.place(ORIGIN, goal, GRID, None)
    start = frame.pose(ORIGIN)
    assert start == pytest.approx(GRID.pose(GRID.lattice_state(start)))
    assert GRID.contains(*frame.point(goal))
    margins = [GRID.side_m / 2 - max(map(abs, point)) for point in (start[:2], frame.point(goal))]
    assert abs(margins[0] - margins[1]) < 3 * GRID.cell_size_m  # both as far inside


def test_a_given_centre_is_taken():
    frame = ArenaFrame.place(ORIGIN, (15.0, 0.0), GRID, (8.0, 0.0))
    assert frame.pose(Pose(1.0, 2.0, 0.5)) == (-7.0, 2.0, 0.5) and frame.point((15.0, 0.0)) == (7.0, 0.0)


@pytest.mark.parametrize(
    ("goal", "centre", "what"),
    [((25.0, 0.0), None, "start"), ((11.0, 0.0), (0.0, 0.0), "goal"), ((math.nan, 0.0), (0.0, 0.0), "goal")],
)
def test_what_does_not_fit_is_one_clear_error(goal, centre, what):
    with pytest.raises(RunError, match=rf"{what} is .* in the odometry's frame; the policy's map covers x"):
        ArenaFrame.place(ORIGIN, goal, GRID, centre)
