import numpy as np
import pytest

from zsdist.agent import reward_shaping
from zsdist.agent.reward_shaping import Step, TrajectoryBuilder
from zsdist.planning.grid import Grid
from zsdist.types import NO_GUIDE, Action, Behaviour, Level

PLAIN = {"revisits": 0, "reentries": 0, "squeezed": False, "reached": False, "collided": False}


def track(level, steps=3, discount=0.5):
    made = TrajectoryBuilder(level, discount, weight_version=7)
    for index in range(steps):
        made.act(np.full(2, index, np.float32), np.ones(5, bool), index, None if index else 2, Behaviour.GREEDY)
        made.reward(float(2**index))
    return made


END = np.full(2, 9, np.float32), np.zeros(5, bool)


def test_low_transitions_follow_each_other_and_only_the_last_can_be_final():
    trajectory = track(Level.LOW).close(*END, final=True)
    assert list(trajectory.successors) == [1, 2, 3]
    assert list(trajectory.discounts) == [0.5, 0.5, 0.0]
    assert list(trajectory.rewards) == [1, 2, 4]
    assert list(trajectory.states[:, 0]) == [0, 1, 2, 9]
    assert list(trajectory.guides) == [2, NO_GUIDE, NO_GUIDE]
    assert trajectory.masks.shape == (4, 5) and not trajectory.masks[-1].any()
    assert trajectory.weight_version == 7


@pytest.mark.parametrize("final", [False, True])
def test_every_step_of_an_option_is_a_transition_to_where_it_ended(final):
    trajectory = track(Level.HIGH).close(*END, final=final)
    assert list(trajectory.successors) == [3, 3, 3]
    assert list(trajectory.rewards) == [1 + 0.5 * 2 + 0.25 * 4, 2 + 0.5 * 4, 4]
    assert list(trajectory.discounts) == ([0, 0, 0] if final else [0.125, 0.25, 0.5])


def test_a_step_that_was_begun_but_not_rewarded_is_no_transition():
    begun = track(Level.LOW, steps=2)
    begun.act(np.full(2, 5, np.float32), np.ones(5, bool), 0, None, Behaviour.GREEDY)
    trajectory = begun.close(*END, final=False)
    assert len(trajectory) == 2 and list(trajectory.states[:, 0]) == [0, 1, 9]
    assert TrajectoryBuilder(Level.LOW, 0.9, 1).close(*END, final=False) is None


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
    for worse in ({"revisits": 1}, {"squeezed": True}, {"collided": True}):
        assert Step(**PLAIN | worse).low_reward(0.6, entered=False) < on
    again = Step(**PLAIN | {"reentries": 1})
    assert again.high_reward(0.6) < Step(**PLAIN).high_reward(0.6)
    assert again.low_reward(0.6, entered=False) == on


def test_a_collision_costs_more_than_any_step_can_gain():
    best = Step(**PLAIN | {"collided": True}).low_reward(reward_shaping.MAX_PROGRESS_M, entered=True)
    assert best < Step(**PLAIN | {"revisits": 99, "squeezed": True}).low_reward(0.0, entered=False)


def test_turns_count_in_the_length_of_a_way():
    costs = reward_shaping.way_costs(Grid())
    assert costs[0, Action.FORWARD] < costs[7, Action.LEFT_45]
    assert costs[0, Action.TURN_LEFT_90] == costs[0, Action.TURN_RIGHT_90] > 0.1
