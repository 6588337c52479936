import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zsdist.replay.n_step_returns import n_step


def made(rng, lengths, ends):
    """Return rows, successors, rewards and discounts of joined trajectories; some transitions end their episode."""
    count = sum(lengths)
    trajectory = np.repeat(np.arange(len(lengths)), lengths)
    rows = np.arange(count) + trajectory
    rewards = rng.normal(size=count).astype(np.float32)
    discounts = np.where(rng.random(count) < ends, 0, 0.9).astype(np.float32)
    return rows, rows + 1, rewards, discounts, trajectory


def one_by_one(steps, rows, successors, rewards, discounts, usable, start):
    """Return the same n-step return, computed step by step."""
    where = {int(row): index for index, row in enumerate(rows) if usable[index]}
    total, left, end = float(rewards[start]), float(discounts[start]), int(successors[start])
    for _ in range(steps - 1):
        following = where.get(end)
        if following is None or left == 0:
            break
        total += left * float(rewards[following])
        left *= float(discounts[following])
        end = int(successors[following])
    return total, left, end


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    lengths=st.lists(st.integers(1, 9), min_size=1, max_size=5),
    steps=st.integers(1, 6),
    ends=st.sampled_from([0.0, 0.3]),
)
def test_a_return_is_that_of_following_the_trajectory_step_by_step(seed, lengths, steps, ends):
    rng = np.random.default_rng(seed)
    *columns, trajectory = made(rng, lengths, ends)
    usable = rng.random(len(trajectory)) < 0.8
    rewards, discounts, successors = n_step(steps, *columns, usable)
    for start in np.flatnonzero(usable):
        total, left, end = one_by_one(steps, *columns, usable, start)
        assert rewards[start] == pytest.approx(total, rel=1e-5, abs=1e-6)
        assert discounts[start] == pytest.approx(left, rel=1e-6)
        assert successors[start] == end


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32), lengths=st.lists(st.integers(1, 9), min_size=2, max_size=5))
def test_no_return_crosses_from_one_trajectory_into_the_next(seed, lengths):
    rows, following, rewards, discounts, trajectory = made(np.random.default_rng(seed), lengths, 0.0)
    rewards[:] = 1000.0**trajectory  # a reward of another trajectory would be noticed
    discounts[:] = 1.0
    total, _, successors = n_step(100, rows, following, rewards, discounts, np.ones(len(rows), bool))
    last = np.cumsum(lengths) + np.arange(len(lengths))  # row of each trajectory's last state
    assert (successors == last[trajectory]).all()
    left = last[trajectory] - rows
    np.testing.assert_allclose(total, left * 1000.0**trajectory, rtol=1e-6)


def test_no_return_continues_after_the_end_of_an_episode():
    rows = np.arange(4)
    rewards, discounts = np.array([1, 2, 4, 8], np.float32), np.array([0.5, 0, 0.5, 0.5], np.float32)
    total, left, successors = n_step(3, rows, rows + 1, rewards, discounts, np.ones(4, bool))
    assert total.tolist() == [2, 2, 8, 8]
    assert left.tolist() == [0, 0, 0.25, 0.5]
    assert successors.tolist() == [2, 2, 4, 4]


def test_transitions_that_end_an_option_have_nothing_to_join():
    rows, end = np.arange(4), np.full(4, 4)
    rewards, discounts = np.arange(4, dtype=np.float32), np.full(4, 0.9, np.float32)
    total, left, successors = n_step(5, rows, end, rewards, discounts, np.ones(4, bool))
    assert np.array_equal(total, rewards) and np.array_equal(left, discounts) and np.array_equal(successors, end)


def test_a_return_beyond_float32_stays_shorter():
    largest = np.finfo(np.float32).max
    rows, discounts = np.arange(3), np.ones(3, np.float32)
    total, _, successors = n_step(3, rows, rows + 1, np.full(3, largest), discounts, np.ones(3, bool))
    assert total.tolist() == [largest] * 3 and successors.tolist() == [1, 2, 3]
