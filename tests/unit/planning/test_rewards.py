import pytest

from zsdist.planning.rewards import RewardTerms, obstacle_avoidance, target_distance, target_reached


def test_eq18_distance_term_is_minus_the_metres_left():
    assert target_distance((1.0, 2.0), (4.0, -2.0)) == pytest.approx(-5.0)
    assert target_distance((4.0, -2.0), (4.0, -2.0)) == 0.0


def test_eq19_collision_and_safety_each_have_their_value():
    assert obstacle_avoidance(True, collision=-200.0, safe=0.5) == -200.0
    assert obstacle_avoidance(False, collision=-200.0, safe=0.5) == 0.5


def test_eq20_goal_and_every_other_step_each_have_their_value():
    assert target_reached(True, goal=1000.0, step=-0.1) == 1000.0
    assert target_reached(False, goal=1000.0, step=-0.1) == -0.1


def test_total_is_the_sum_of_the_three_terms():
    assert RewardTerms(-3.0, -200.0, 1.0).total == -202.0
