import numpy as np
import pytest

from zsdist.agent.recorder import TrajectoryBuilder
from zsdist.types import NO_GUIDE, Behaviour, Level


def builder(level, steps=3, discount=0.5):
    made = TrajectoryBuilder(level, discount, weight_version=7)
    for index in range(steps):
        made.act(np.full(2, index, np.float32), np.ones(5, bool), index, None if index else 2, Behaviour.GREEDY)
        made.reward(float(2**index))
    return made


END = np.full(2, 9, np.float32), np.zeros(5, bool)


def test_low_transitions_follow_each_other_and_only_the_last_can_be_final():
    trajectory = builder(Level.LOW).close(*END, final=True)
    assert list(trajectory.successors) == [1, 2, 3]
    assert list(trajectory.discounts) == [0.5, 0.5, 0.0]
    assert list(trajectory.rewards) == [1, 2, 4]
    assert list(trajectory.states[:, 0]) == [0, 1, 2, 9]
    assert list(trajectory.guides) == [2, NO_GUIDE, NO_GUIDE]
    assert trajectory.masks.shape == (4, 5) and not trajectory.masks[-1].any()
    assert trajectory.weight_version == 7


@pytest.mark.parametrize("final", [False, True])
def test_every_step_of_an_option_is_a_transition_to_where_it_ended(final):
    trajectory = builder(Level.HIGH).close(*END, final=final)
    assert list(trajectory.successors) == [3, 3, 3]
    assert list(trajectory.rewards) == [1 + 0.5 * 2 + 0.25 * 4, 2 + 0.5 * 4, 4]
    assert list(trajectory.discounts) == ([0, 0, 0] if final else [0.125, 0.25, 0.5])


def test_a_step_that_was_begun_but_not_rewarded_is_no_transition():
    begun = builder(Level.LOW, steps=2)
    begun.act(np.full(2, 5, np.float32), np.ones(5, bool), 0, None, Behaviour.GREEDY)
    trajectory = begun.close(*END, final=False)
    assert len(trajectory) == 2 and list(trajectory.states[:, 0]) == [0, 1, 9]
    assert TrajectoryBuilder(Level.LOW, 0.9, 1).close(*END, final=False) is None
