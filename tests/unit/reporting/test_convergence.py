from types import SimpleNamespace

import numpy as np
import pytest

from zsdist.config import Config, load
from zsdist.reporting import convergence


def run_of(returns, steps=None, outcomes=None, window=50):
    steps, outcomes = steps or [10] * len(returns), outcomes or ["success"] * len(returns)
    rows = zip(returns, steps, outcomes, strict=True)
    episodes = [{"return": one, "steps": taken, "outcome": how} for one, taken, how in rows]
    return SimpleNamespace(episodes=episodes, settings=load(overrides=(f"replay.average_episodes={window}",)))


def test_running_mean_grows_into_its_window():
    np.testing.assert_allclose(convergence.running_mean(np.array([2.0, 4.0, 6.0, 8.0]), 2), [2.0, 3.0, 5.0, 7.0])


def test_the_curve_of_episodes_is_the_mean_return_of_the_last_of_them():
    np.testing.assert_allclose(convergence.per_episode(run_of([4.0, 0.0, 2.0], window=2)), [4.0, 2.0, 1.0])
    assert Config().replay.average_episodes == 50


def test_the_curve_of_actions_is_all_reward_over_all_actions():
    np.testing.assert_allclose(convergence.per_action(run_of([10.0, -30.0], [10, 30])), [1.0, -0.5])


def test_shares_count_the_given_outcome():
    run = run_of([0.0] * 4, outcomes=["collision", "success", "collision", "timeout"])
    np.testing.assert_allclose(convergence.share(run, "collision", 2), [1.0, 0.5, 0.5, 0.5])


def test_a_curve_has_converged_from_where_it_stays_near_its_final_value():
    curve = np.concatenate([np.linspace(-100.0, 100.0, 50), np.full(50, 100.0)])
    found = convergence.converged(curve)
    assert found.final == 100.0
    assert abs(curve[found.episode - 1] - 100.0) <= 20.0 < abs(curve[found.episode - 2] - 100.0)


def test_a_curve_that_leaves_its_final_value_late_has_converged_late():
    curve = np.full(100, 1.0)
    curve[[0, 70]] = 0.0
    assert convergence.converged(curve).episode == 72


def test_a_curve_that_still_rises_at_its_end_has_not_converged():
    assert convergence.converged(np.linspace(0.0, 1.0, 100) ** 8).episode is None


def test_a_flat_curve_has_converged_from_the_first_episode():
    assert convergence.converged(np.full(30, 5.0)) == convergence.Convergence(5.0, 1)


def test_too_few_episodes_give_no_result():
    assert convergence.converged(np.zeros(19)) is None and convergence.fluctuation(run_of([1.0] * 19)) is None


def test_fluctuation_is_that_of_each_half():
    calm_later = [100.0, -100.0] * 10 + [0.0] * 20
    first, last = convergence.fluctuation(run_of(calm_later, window=2))
    assert first > 50.0 and last < 25.0
    assert convergence.fluctuation(run_of([3.0] * 40)) == (0.0, 0.0)


@pytest.mark.parametrize("lengths", [(3,), (3, 5)])
def test_a_band_covers_the_episodes_that_all_curves_have(lengths):
    curves = [np.arange(length, dtype=float) + index for index, length in enumerate(lengths)]
    mean, low, high = convergence.band(curves)
    assert len(mean) == 3 and (low <= mean).all() and (mean <= high).all()
    np.testing.assert_allclose(high - low, len(lengths) - 1)
