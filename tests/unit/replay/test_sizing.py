import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zsdist.config import ReplayConfig
from zsdist.replay.sizing import (
    AdaptiveSizing,
    RewardAverages,
    batch_size,
    buffer_size,
    cumulative_average_reward,
    progress,
)

CONFIG = ReplayConfig(target_return=700.0)
FINITE = st.floats(-1e6, 1e6)


def test_eq21_the_average_is_over_all_actions_so_far():
    assert cumulative_average_reward(-30.0, 4) == -7.5
    averages = RewardAverages(average_episodes=2)
    assert averages.mean_reward is None and averages.mean_return is None
    for paper_return, actions in ((-100.0, 10), (900.0, 30), (500.0, 60)):
        averages.add_episode(paper_return, actions)
    assert averages.mean_reward == pytest.approx(1300 / 100)
    assert averages.mean_return == 700.0  # mean of the last two


def test_eq22_the_buffer_size_goes_from_its_minimum_to_its_maximum_with_the_ratio():
    assert [buffer_size(1000, 20_000, average, 800.0) for average in (0.0, 400.0, 800.0, 2000.0)] == [
        1000,
        10_500,
        20_000,
        20_000,
    ]


def test_eq23_the_batch_size_goes_from_its_minimum_to_its_maximum_with_the_ratio():
    assert [batch_size(16, 256, average, 800.0) for average in (0.0, 400.0, 800.0, 2000.0)] == [16, 136, 256, 256]


@given(average=FINITE, better=st.floats(0, 1e6), target=FINITE)
def test_progress_is_a_share_that_never_falls_as_the_average_rises_whatever_the_sign_of_the_target(
    average, better, target
):
    now, then = progress(average, target), progress(average + better, target)
    assert 0.0 <= now <= then <= 1.0
    assert progress(target, target) == 1.0


def test_a_return_twice_as_bad_as_a_negative_target_is_half_way_not_beyond():
    assert progress(-300.0, -150.0) == 0.5
    assert progress(-5000.0, 700.0) == 0.0


def test_sizes_start_at_table_2_and_change_only_every_tenth_episode():
    sizing = AdaptiveSizing(CONFIG)
    for finished in range(10):
        assert not sizing.adjust(finished, -5000.0)
    assert (sizing.size, sizing.batch_size) == (10_000, 128)
    assert sizing.adjust(10, -5000.0)
    assert (sizing.size, sizing.batch_size) == (9000, 115)
    assert not sizing.adjust(10, -5000.0) and not sizing.adjust(4, -5000.0)
    assert (sizing.size, sizing.batch_size) == (9000, 115)


def test_a_good_run_grows_to_the_maximum_and_a_bad_one_shrinks_to_the_minimum_by_at_most_the_rate():
    sizing = AdaptiveSizing(CONFIG)
    for finished in range(10, 400, 10):
        before = sizing.size
        sizing.adjust(finished, -5000.0)
        assert before * 0.9 - 1 <= sizing.size <= before
    assert (sizing.size, sizing.batch_size) == (1000, 16)
    for finished in range(400, 1200, 10):
        before = sizing.size
        sizing.adjust(finished, 900.0)
        assert before <= sizing.size <= before / 0.9 + 1
    assert sizing.size >= 20_000 / 1.2 and sizing.batch_size >= 256 / 1.2


def test_sizes_stay_between_the_thresholds():
    sizing = AdaptiveSizing(CONFIG)
    for wanted in (10_000, 11_900):
        average = 700.0 * (wanted - 1000) / 19_000
        finished = wanted  # a multiple of ten
        sizing.adjust(finished, average)
        assert sizing.size == 10_000


def test_several_adjustments_that_are_due_at_once_are_all_made():
    at_once, one_by_one = AdaptiveSizing(CONFIG), AdaptiveSizing(CONFIG)
    at_once.adjust(35, -5000.0)
    for finished in (10, 20, 30):
        one_by_one.adjust(finished, -5000.0)
    assert at_once.state() == one_by_one.state()


def test_a_fixed_size_stays_and_so_does_one_without_a_mean():
    fixed, unknown = AdaptiveSizing(CONFIG.model_copy(update={"adaptive": False})), AdaptiveSizing(CONFIG)
    assert not fixed.adjust(100, -5000.0) and not unknown.adjust(100, None)
    assert (fixed.size, unknown.size) == (10_000, 10_000)


def test_a_restored_sizing_continues_the_same_through_json():
    sizing, restored = AdaptiveSizing(CONFIG), AdaptiveSizing(CONFIG)
    averages, same = RewardAverages(3), RewardAverages(3)
    for episode in range(1, 16):
        averages.add_episode(-10.0 * episode / 3, episode)
        sizing.adjust(episode, averages.mean_return)
    restored.restore(json.loads(json.dumps(sizing.state())), 15)
    same.restore(json.loads(json.dumps(averages.state())))
    averages.add_episode(5.0, 2)
    same.add_episode(5.0, 2)
    assert (averages.mean_return, averages.mean_reward) == (same.mean_return, same.mean_reward)
    assert sizing.adjust(20, 900.0) == restored.adjust(20, 900.0)
    assert sizing.state() == restored.state()


def test_sizes_of_other_bounds_are_restored_within_the_present_ones():
    sizing = AdaptiveSizing(CONFIG)
    for size, batch in ((CONFIG.size_max + 1, CONFIG.batch_max + 1), (CONFIG.size_min - 1, CONFIG.batch_min - 1)):
        sizing.restore({"size": size, "batch_size": batch, "adjustments": 0}, 0)
        assert CONFIG.size_min <= sizing.size <= CONFIG.size_max, "a replay refuses all orders with any other"
        assert CONFIG.batch_min <= sizing.batch_size <= CONFIG.batch_max


def test_other_initial_sizes_begin_where_they_are_set_and_equal_ones_change_nothing():
    sizing = AdaptiveSizing(CONFIG)
    sizing.adjust(100, -5000.0)
    state = sizing.state()
    assert state["size"] != CONFIG.size_initial
    changed = AdaptiveSizing(CONFIG.model_copy(update={"size_initial": 7000, "batch_initial": 64}))
    changed.restore(state, 100)
    assert (changed.size, changed.batch_size) == (7000, 64)
    again = AdaptiveSizing(CONFIG.model_copy(update={"size_initial": 7000, "batch_initial": 64}))
    again.restore(changed.state() | {"size": 6000}, 100)
    assert again.size == 6000, "it began at the change, not at every start"


@pytest.mark.parametrize(("every", "due"), [(1, 101), (20, 120), (10, 110)])
def test_adjustments_count_from_the_change_of_their_interval(every, due):
    before, after = AdaptiveSizing(CONFIG), AdaptiveSizing(CONFIG.model_copy(update={"adjust_every_episodes": every}))
    before.adjust(100, None)
    after.restore(before.state(), 100)
    sizes = [(finished, after.size) for finished in range(101, 121) if after.adjust(finished, -5000.0)]
    assert sizes[0] == (due, math.floor(CONFIG.size_initial * CONFIG.shrink_rate)), "one adjustment, when it is due"


@pytest.mark.parametrize(("paper_return", "actions"), [(float("nan"), 3), (float("inf"), 3), (1.0, -1)])
def test_returns_that_are_not_finite_are_rejected(paper_return, actions):
    with pytest.raises(ValueError, match="allowed are finite"):
        RewardAverages(5).add_episode(paper_return, actions)


def test_a_mean_that_is_not_finite_is_rejected():
    with pytest.raises(ValueError, match="mean return is nan"):
        AdaptiveSizing(CONFIG).adjust(10, float("nan"))
