import numpy as np
import pytest

from zsdist.agent import reward_shaping
from zsdist.agent.reward_shaping import Step
from zsdist.planning.grid import Grid
from zsdist.types import Action

PLAIN = {"revisits": 0, "reentries": 0, "gave_way": False, "reached": False, "collided": False}


def test_progress_is_measured_along_the_way_and_is_nothing_where_there_is_none():
    cost = np.full((4, 4, 8), np.inf)
    cost[0, 0, 0], cost[0, 1, 0], cost[0, 2, 0] = 3.0, 2.4, 9.0
    assert reward_shaping.progress_m(cost, (0, 0, 0), (0, 1, 0)) == pytest.approx(0.6)
    assert reward_shaping.progress_m(cost, (0, 1, 0), (0, 2, 0)) == -reward_shaping.MAX_PROGRESS_M
    assert reward_shaping.progress_m(cost, (0, 0, 0), (1, 1, 1)) == 0.0
    assert reward_shaping.progress_m(cost, (1, 1, 1), (0, 0, 0)) == 0.0


def test_arriving_is_better_than_going_on_and_everything_else_worse():
    on = Step(**PLAIN).low_reward(0.6, entered=False)
    assert on > 0 > Step(**PLAIN).low_reward(0.0, entered=False)
    assert Step(**PLAIN).low_reward(0.6, entered=True) > on
    assert Step(**PLAIN | {"reached": True}).low_reward(0.6, entered=False) > on
    for worse in ({"revisits": 1}, {"gave_way": True}, {"collided": True}):
        assert Step(**PLAIN | worse).low_reward(0.6, entered=False) < on
    again = Step(**PLAIN | {"reentries": 1})
    assert again.high_reward(0.6) < Step(**PLAIN).high_reward(0.6)
    assert again.low_reward(0.6, entered=False) == on


def test_a_collision_costs_more_than_any_step_can_gain():
    best = Step(**PLAIN | {"collided": True}).low_reward(reward_shaping.MAX_PROGRESS_M, entered=True)
    assert best < Step(**PLAIN | {"revisits": 99, "gave_way": True}).low_reward(0.0, entered=False)


def test_turns_count_in_the_length_of_a_way():
    costs = reward_shaping.path_costs(Grid())
    assert costs[0, Action.FORWARD] < costs[7, Action.LEFT_45]
    assert costs[0, Action.TURN_LEFT_90] == costs[0, Action.TURN_RIGHT_90] > 0.1
