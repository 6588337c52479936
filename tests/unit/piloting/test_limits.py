import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zsdist.piloting.limits import LONGEST_STEP_S, STANDSTILL, MotionLimits
from zsdist.ros2.messages import Velocity

LIMITS = MotionLimits(0.7, 0.9, 1.1, 2.3)
ANY = st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(st.tuples(ANY, ANY, ANY), max_size=30))
def test_no_velocity_is_beyond_a_limit_whatever_is_wanted(wishes):
    before = STANDSTILL
    for speed, turn, step_s in wishes:
        velocity = LIMITS.apply(Velocity(speed, turn), before, step_s)
        assert 0.0 <= velocity.speed_mps <= 0.7 and abs(velocity.turn_rad_s) <= 0.9
        passed_s = min(max(step_s, 0.0), LONGEST_STEP_S) if math.isfinite(step_s) else 0.0
        assert abs(velocity.speed_mps - before.speed_mps) <= 1.1 * passed_s + 1e-12
        assert abs(velocity.turn_rad_s - before.turn_rad_s) <= 2.3 * passed_s + 1e-12
        before = velocity


def test_what_the_limits_allow_is_given():
    assert LIMITS.apply(Velocity(0.05, -0.1), STANDSTILL, 0.1) == Velocity(0.05, -0.1)


def test_what_is_not_finite_means_stop():
    velocity = LIMITS.apply(Velocity(math.nan, math.inf), Velocity(0.05, 0.1), 0.1)
    assert velocity == STANDSTILL


def test_a_pause_between_commands_allows_no_leap():
    assert LIMITS.apply(Velocity(0.7, 0.0), STANDSTILL, 60.0).speed_mps == pytest.approx(1.1 * LONGEST_STEP_S)
