import pytest

from zsdist.sim.scenes.scene import Obstacle
from zsdist.sim.scenes.walkers import Walker
from zsdist.types import Pose

FAR = Pose(-9.0, -9.0, 0.0)
BENT = Obstacle("person", 0.0, 0.0, 0.3, path=((0.0, 0.0), (2.0, 0.0), (2.0, 1.0)), speed_mps=1.0)


@pytest.mark.parametrize(
    ("seconds", "place"),
    [(0.5, (0.5, 0.0)), (2.5, (2.0, 0.5)), (3.5, (2.0, 0.5)), (5.5, (0.5, 0.0)), (6.5, (0.5, 0.0))],
)
def test_a_person_walks_back_and_forth_along_its_path(seconds, place):
    walker = Walker(BENT)
    for _ in range(round(seconds / 0.05)):
        assert walker.walk(FAR, 0.05)
    assert (walker.x_m, walker.y_m) == pytest.approx(place, abs=1e-9)


def test_a_person_stands_while_the_car_is_within_a_metre_and_a_half_and_then_walks_on():
    walker = Walker(BENT)
    near = Pose(0.0, 0.545 + 0.3 + 1.4, 0.0)
    assert not walker.walk(near, 1.0)
    assert (walker.x_m, walker.y_m) == (0.0, 0.0)
    assert walker.walk(near._replace(y_m=near.y_m + 0.2), 1.0)
    assert (walker.x_m, walker.y_m) == pytest.approx((1.0, 0.0))
