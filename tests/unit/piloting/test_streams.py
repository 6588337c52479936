import math

import pytest

from zsdist.piloting.streams import MEMORY_S, Freshness

ROBOT_S = 1e9  # the robot's clock does not agree with ours


def stream(offset_s=ROBOT_S, until_s=2.0, every_s=0.1, delay_s=0.0):
    made = Freshness("pictures", 0.5)
    for number in range(round(until_s / every_s) + 1):
        made.seen(number * every_s + delay_s, number * every_s + offset_s)
    return made


def test_before_the_first_message_the_robot_has_to_stand():
    assert Freshness("pictures", 0.5).fault(0.0) == "no pictures yet"
    assert Freshness("pictures", 0.5).age_s(3.0) == math.inf


@pytest.mark.parametrize("offset_s", [ROBOT_S, 0.0, -100.0])
def test_a_steady_stream_is_fresh_whatever_the_clock_of_the_robot_says(offset_s):
    made = stream(offset_s)
    assert made.fault(2.4) is None and made.age_s(2.4) == pytest.approx(0.4)


def test_a_stream_that_ends_stops_the_robot_after_the_limit():
    made = stream()
    assert made.fault(2.49) is None
    assert made.fault(2.51) == "no pictures for 0.5 s"


def test_what_comes_late_is_old_although_it_has_just_arrived():
    made = stream()
    made.seen(4.0, ROBOT_S + 3.2)
    assert made.age_s(4.0) == pytest.approx(0.8) and made.fault(4.0) == "pictures come 0.8 s late"
    made.seen(4.1, ROBOT_S + 4.1)
    assert made.fault(4.1) is None


@pytest.mark.parametrize("jump_s", [3600.0, 0.8])
def test_a_clock_that_jumps_ahead_is_told_once(jump_s):
    made = stream()
    made.seen(2.1, ROBOT_S + 2.1 + jump_s)
    assert made.fault(2.1) == f"the clock of the pictures jumped by {jump_s:+.1f} s"
    assert made.fault(2.1) is None
    made.seen(2.2, ROBOT_S + 2.2 + jump_s)
    assert made.fault(2.2) is None


def test_a_clock_that_is_set_back_stops_the_robot_until_it_is_believed():
    made = stream()
    faults = []
    for number in range(40):
        now = 2.1 + 0.1 * number
        made.seen(now, ROBOT_S + now - 100.0)
        faults.append(made.fault(now))
    told = [fault for fault in faults if fault and "jumped by -100.0 s" in fault]
    assert faults[0] == "pictures come 100.0 s late" and len(told) == 1
    assert faults[round(MEMORY_S / 0.1) + 3 :] == [None] * (40 - round(MEMORY_S / 0.1) - 3)


def test_a_steady_delay_is_no_delay_but_more_of_it_is():
    made = stream(delay_s=0.3)
    assert made.fault(2.3) is None and made.age_s(2.3) == pytest.approx(0.0)
    made.seen(2.9, ROBOT_S + 2.1)
    assert made.age_s(2.9) == pytest.approx(0.5)
