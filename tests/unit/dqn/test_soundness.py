from dataclasses import replace

import numpy as np
import pytest
from learner_batches import ACTIONS, MIRROR, STATE_SIZE, batch, same_arrays

from zsdist.config import LevelConfig
from zsdist.dqn import soundness
from zsdist.dqn.fused import FusedDqnLearner
from zsdist.dqn.learner import DqnLearner
from zsdist.dqn.soundness import Quantity, UnsoundUpdateError

SETTINGS = LevelConfig(hidden=(8, 8), target_tau=0.01)
WEIGHTED = replace(batch(0), weights=np.full(32, 0.5, np.float32))


@pytest.fixture(params=[DqnLearner, FusedDqnLearner])
def learner(request):
    made = request.param(STATE_SIZE, ACTIONS, SETTINGS, seed=3, mirror=MIRROR)
    for seed in range(3):
        made.update(batch(seed))
    return made


def spoilt(array, value):
    changed = array.copy()
    changed.ravel()[-1] = value
    return changed


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("column", ["states", "rewards", "discounts", "next_states", "weights"])
def test_an_update_by_a_spoilt_batch_is_not_made_and_its_column_is_named(learner, column, value):
    bad, before = replace(WEIGHTED, **{column: spoilt(getattr(WEIGHTED, column), value)}), learner.state()
    with pytest.raises(UnsoundUpdateError):
        learner.update(bad)
    assert same_arrays(before, learner.state())
    assert learner.examine(bad).startswith(f"{column} of the batch: {value}")
    assert same_arrays(before, learner.state())


@pytest.mark.parametrize("name", ["online/hidden0.weight", "target/output.bias"])
def test_an_update_of_a_spoilt_network_is_not_made_and_its_tensor_is_named(learner, name):
    state = learner.state()
    learner.restore(state | {name: np.full_like(state[name], np.nan)}, check=False)
    with pytest.raises(UnsoundUpdateError):
        learner.update(WEIGHTED)
    assert learner.examine(WEIGHTED).startswith(f"{name} of the learner: nan")


def test_a_value_beyond_the_limit_is_found_before_it_is_learned_from(learner):
    learner.limit, before = 100.0, learner.state()
    large = replace(WEIGHTED, rewards=np.full(32, 1e4, np.float32))
    with pytest.raises(UnsoundUpdateError) as refused:
        learner.update(large)
    assert 1e3 < refused.value.largest < 1e5
    assert same_arrays(before, learner.state())
    assert learner.examine(large).startswith("errors: -")


def test_the_first_of_two_wrong_quantities_is_the_one_that_caused_the_other(learner):
    huge = replace(WEIGHTED, rewards=np.full(32, 3e38, np.float32))
    sound = replace(huge, rewards=np.ones(32, np.float32))
    assert learner.examine(sound) is None
    state = learner.state()
    learner.restore(state | {"online/output.bias": np.full(ACTIONS, -3e38, np.float32)}, check=False)
    with pytest.raises(UnsoundUpdateError):
        learner.update(huge)
    assert learner.examine(huge).startswith("errors: -inf")


def test_an_update_after_a_refused_one_is_the_one_that_would_have_been_made_without_it():
    learners = [FusedDqnLearner(STATE_SIZE, ACTIONS, SETTINGS, seed=3, mirror=MIRROR) for _ in range(2)]
    with pytest.raises(UnsoundUpdateError):
        learners[0].update(replace(WEIGHTED, rewards=spoilt(WEIGHTED.rewards, np.nan)))
    for made in learners:
        made.update(WEIGHTED)
    assert same_arrays(*(made.state() for made in learners))


@pytest.mark.parametrize(("numbers", "found"), [([1.0, -7.0, 3.0], 7.0), ([], 0.0), ([1.0, -np.inf], np.inf)])
def test_the_largest_magnitude(numbers, found):
    assert soundness.largest_magnitude(np.array(numbers, np.float32)) == found


def test_the_largest_magnitude_with_a_nan_is_nan_wherever_it_is():
    for place in range(3):
        numbers = np.array([1.0, 2.0, 3.0], np.float32)
        numbers[place] = np.nan
        assert np.isnan(soundness.largest_magnitude(numbers))


def test_the_first_unsound_quantity_is_named_with_its_place():
    fine, bad = Quantity("fine", np.ones((2, 2))), Quantity("bad", np.array([[1.0, 2.0], [3.0, np.nan]]))
    assert (
        soundness.first_unsound([fine, bad, Quantity("later", np.array(np.inf))])
        == "bad: nan at [1, 1], 1 of 4 numbers"
    )
    assert (
        soundness.first_unsound([fine, Quantity("large", np.array([1.0, 9.0]), 5.0)])
        == "large: 9 at [1], 1 of 2 numbers"
    )
    assert soundness.first_unsound([fine, Quantity("none", np.zeros((0, 3)))]) is None
