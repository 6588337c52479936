import math

import pytest

from zsdist.sim.physics.controller import GAINS, STOPPED, WHEEL_RADIUS_M, Manoeuvre, Motion
from zsdist.types import Pose

AHEAD = Pose(0.625, 0.0, 0.0)
HERE = Pose(0.0, 0.0, 0.0)


def rest(pose: Pose) -> Motion:
    return Motion(pose, 0.0, 0.0)


def test_the_turn_comes_before_the_advance():
    manoeuvre = Manoeuvre(Pose(0.625, 0.625, math.pi / 4), True, True, 0.05)
    rates = manoeuvre.rates(rest(HERE))
    assert rates.left == -rates.right < 0  # to the left, in place
    rates = manoeuvre.rates(rest(Pose(0.0, 0.0, math.pi / 4)))
    assert rates.left == pytest.approx(rates.right)
    assert rates.left > 0


def test_a_rolling_car_brakes_before_it_turns():
    manoeuvre = Manoeuvre(Pose(0.0, 0.0, math.pi / 2), False, True, 0.05)
    assert manoeuvre.rates(Motion(HERE, 1.0, 0.0)) == STOPPED
    assert manoeuvre.rates(rest(HERE)).right > 0


def test_an_advance_keeps_the_speed_it_begins_with():
    slow = Manoeuvre(AHEAD, True, False, 0.05).rates(rest(HERE))
    fast = Manoeuvre(AHEAD, True, False, 0.05).rates(Motion(HERE, 1.0, 0.0))
    assert slow.left * WHEEL_RADIUS_M == pytest.approx(GAINS.speed_up_mps2 * 0.05)
    assert fast.left * WHEEL_RADIUS_M == pytest.approx(1.0 + GAINS.speed_up_mps2 * 0.05)


@pytest.mark.parametrize(("aside_m", "left_is_faster"), [(0.08, True), (-0.08, False)])
def test_an_advance_steers_back_to_its_line(aside_m, left_is_faster):
    rates = Manoeuvre(AHEAD, True, False, 0.05).rates(rest(Pose(0.0, aside_m, 0.0)))
    assert (rates.left > rates.right) == left_is_faster


def test_a_car_at_its_target_is_done_and_one_that_spins_there_is_not():
    assert Manoeuvre(HERE, False, True, 0.05).rates(rest(HERE)) is None
    assert Manoeuvre(HERE, False, True, 0.05).rates(Motion(HERE, 0.0, 1.0)) == STOPPED


@pytest.mark.parametrize("heading_rad", [-3.1, -1.0, 0.3, 3.1])
def test_rates_stay_within_the_limits_of_the_wheels(heading_rad):
    for advance in (False, True):
        rates = Manoeuvre(AHEAD, advance, False, 0.05).rates(Motion(Pose(0.0, 0.0, heading_rad), 1.5, 0.0))
        most = GAINS.speed_most_mps / WHEEL_RADIUS_M + GAINS.turn_most_rad_s
        assert max(abs(rate) for rate in rates) <= most
