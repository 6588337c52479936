import numpy as np
import pytest

from zsdist.evaluation import statistics
from zsdist.evaluation.statistics import bootstrap_95, wilson_95


def test_wilson_matches_worked_values():
    np.testing.assert_allclose(wilson_95(8, 10), (0.4901625, 0.9433178), atol=1e-6)
    np.testing.assert_allclose(wilson_95(0, 20), (0.0, 0.1611252), atol=1e-6)


@pytest.mark.parametrize(("successes", "trials"), [(0, 1), (1, 1), (5, 9), (50, 50)])
def test_wilson_holds_the_rate_and_stays_inside_0_and_1(successes, trials):
    low, high = wilson_95(successes, trials)
    assert 0 <= low <= successes / trials <= high <= 1 and low < high


def test_wilson_covers_the_true_rate_about_95_times_in_100():
    draws = np.random.default_rng(0).binomial(40, 0.85, size=2000)
    intervals = [wilson_95(int(successes), 40) for successes in draws]
    coverage = np.mean([low <= 0.85 <= high for low, high in intervals])
    assert 0.92 <= coverage <= 0.98


def test_bootstrap_is_centred_on_the_mean_and_narrows_with_more_values():
    rng = np.random.default_rng(1)
    widths = []
    for count in (20, 500):
        values = rng.normal(3.0, 1.0, size=count)
        low, high = bootstrap_95(values, rng)
        assert low < values.mean() < high
        widths.append(high - low)
    assert widths[1] < widths[0] / 2


def test_bootstrap_of_equal_values_has_no_width():
    assert bootstrap_95(np.full(5, 2.0), np.random.default_rng(0)) == (2.0, 2.0)


@pytest.mark.parametrize("call", [lambda: wilson_95(1, 0), lambda: wilson_95(3, 2)])
def test_impossible_counts_are_refused(call):
    with pytest.raises(ValueError, match="trials"):
        call()


def test_bootstrap_of_nothing_is_refused():
    with pytest.raises(ValueError, match="at least one"):
        bootstrap_95(np.array([]), np.random.default_rng(0))


def test_the_interquartile_mean_leaves_a_quarter_out_at_either_end():
    assert statistics.interquartile_mean(np.array([-100.0, 1.0, 2.0, 100.0])) == pytest.approx(1.5)
    assert statistics.interquartile_mean(np.array([0.0, 1.0, 5.0])) == pytest.approx(2.0)


def test_the_interval_of_equal_runs_comes_from_their_scenes_and_equal_scores_have_none():
    rng = np.random.default_rng(0)
    scores = np.tile([0.0, 1.0] * 50, (3, 1))
    mean, low, high = statistics.runs_95(scores, ["a"] * 100, rng)
    assert mean == pytest.approx(0.5) and 0.38 < low < 0.45 and 0.55 < high < 0.62
    assert statistics.runs_95(np.full((3, 8), 0.25), ["a"] * 8, rng) == pytest.approx((0.25, 0.25, 0.25))


def test_differing_runs_widen_the_interval():
    rng, even = np.random.default_rng(0), np.tile([0.0, 1.0] * 50, (3, 1))
    apart = np.stack([np.zeros(100), even[0], np.ones(100)])
    _, low, high = statistics.runs_95(apart, ["a"] * 100, rng)
    assert low < 0.2 and high > 0.8


def test_a_difference_between_strata_adds_no_width():
    rng, scores = np.random.default_rng(0), np.tile([0.0] * 50 + [1.0] * 50, (3, 1))
    assert statistics.runs_95(scores, ["a"] * 50 + ["b"] * 50, rng) == pytest.approx((0.5, 0.5, 0.5))
