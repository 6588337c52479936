import numpy as np
import pytest

from zsdist.planning.policy_map import PolicyMap, advised_action
from zsdist.types import Action, LatticeState

EVERY = np.ones(5, bool)
HERE, THERE = LatticeState(3, 4, 0), LatticeState(3, 4, 1)


@pytest.mark.parametrize(
    ("advice", "action"),
    [([2, -1, -1], Action.FORWARD), ([0, 1, -1], Action.LEFT_45), ([-2, -1, 0], Action.RIGHT_45)],
)
def test_eq12_the_visual_act_action_is_the_best_advised_one(advice, action):
    assert advised_action(np.array(advice, np.float32), EVERY) is action


def test_advice_that_is_masked_gives_way_to_the_next_best_or_to_none():
    advice = np.array([2.0, 0.0, 1.0], np.float32)
    assert advised_action(advice, np.array([False, True, True, True, True])) is Action.RIGHT_45
    assert advised_action(advice, np.array([False, False, False, True, True])) is None


def test_eq13_the_explored_policy_has_exactly_the_poses_with_advice():
    pool = PolicyMap()
    assert pool.explored(HERE) is None
    pool.add(HERE, Action.FORWARD)
    pool.add(THERE, Action.LEFT_45)
    assert (pool.explored(HERE), pool.explored(THERE)) == (Action.FORWARD, Action.LEFT_45)


@pytest.mark.parametrize(
    ("known", "explored", "from_pool"), [(1, 1, True), (1, 0, False), (0, 1, False), (0, 0, False)]
)
def test_eq17_the_global_policy_is_the_advice_where_explored_and_the_field_elsewhere(known, explored, from_pool):
    pool = PolicyMap()
    if known:
        pool.add(HERE, Action.RIGHT_45)
    action, pooled = pool.overall(HERE, bool(explored), lambda: Action.TURN_LEFT_90)
    assert pooled is from_pool
    assert action is (Action.RIGHT_45 if from_pool else Action.TURN_LEFT_90)
