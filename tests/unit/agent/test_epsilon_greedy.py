import numpy as np
import pytest

from zsdist.agent.epsilon_greedy import EpsilonGreedy
from zsdist.errors import RunError
from zsdist.types import Behaviour

STATE, MASK = np.zeros(3, np.float32), np.array([True, True, False])


def choose(values, epsilon=0.0):
    rule = EpsilonGreedy(epsilon, 0.8, np.random.default_rng(0))
    q = lambda states: np.array([values], np.float32)  # noqa: E731
    return rule.choose(q, STATE, MASK, guided=None, instead=None)


@pytest.mark.parametrize("values", [[np.nan, 1.0, 2.0], [1.0, np.nan, 2.0], [1.0, 2.0, np.inf], [-np.inf, 1.0, 2.0]])
def test_no_action_is_chosen_by_values_that_are_not_finite(values):
    with pytest.raises(RunError, match="values of the network in a state hold"):
        choose(values)


def test_the_best_allowed_action_is_chosen_and_a_better_forbidden_one_is_noticed():
    choice = choose([1.0, 2.0, 3.0])
    assert (choice.index, choice.behaviour, choice.changed) == (1, Behaviour.GREEDY, True)
