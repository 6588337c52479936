import math

import pytest

from zsdist.types import Pose


@pytest.mark.parametrize(
    ("heading_deg", "point", "bearing_deg", "distance_m"),
    [(0, (3, 0), 0, 2), (0, (1, 4), 90, 4), (90, (3, 0), -90, 2), (170, (-1, 0), 10, 2), (-170, (-1, 0), -10, 2)],
)
def test_a_point_is_seen_from_a_pose_left_positive_and_within_half_a_turn(heading_deg, point, bearing_deg, distance_m):
    bearing_rad, distance = Pose(1.0, 0.0, math.radians(heading_deg)).towards(*point)
    assert math.degrees(bearing_rad) == pytest.approx(bearing_deg)
    assert distance == pytest.approx(distance_m)
