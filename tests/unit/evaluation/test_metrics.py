import dataclasses
import json

import numpy as np
import pytest
from fakes import RECORD

from zsdist.evaluation import metrics, records
from zsdist.evaluation.records import EpisodeRecord
from zsdist.types import Outcome, Pose


def record(**changes) -> EpisodeRecord:
    return dataclasses.replace(RECORD, **changes)


def test_spl_is_the_shortest_over_the_driven_length():
    assert metrics.spl(RECORD) == pytest.approx(0.75)


def test_spl_never_exceeds_1_for_a_path_shorter_than_the_planners():
    assert metrics.spl(record(path_m=14.0)) == 1.0


@pytest.mark.parametrize("outcome", [Outcome.COLLISION, Outcome.TIMEOUT])
def test_spl_of_a_failure_is_0_whatever_its_length(outcome):
    assert metrics.spl(record(outcome=outcome, path_m=15.0)) == 0.0


def test_soft_spl_equals_spl_at_success():
    assert metrics.soft_spl(RECORD) == metrics.spl(RECORD)


def test_soft_spl_credits_the_way_made_good():
    half_way = record(outcome=Outcome.TIMEOUT, remaining_m=7.5, path_m=7.5)
    assert metrics.soft_spl(half_way) == pytest.approx(0.5)
    assert metrics.soft_spl(dataclasses.replace(half_way, path_m=30.0)) == pytest.approx(0.25)


def test_soft_spl_of_a_car_that_ends_farther_away_is_0():
    assert metrics.soft_spl(record(outcome=Outcome.TIMEOUT, remaining_m=18.0)) == 0.0


def test_efficiencies_are_of_steps_and_of_lengths_and_of_successes_only():
    assert metrics.step_efficiency(RECORD) == pytest.approx(0.8)
    assert metrics.path_efficiency(RECORD) == pytest.approx(0.75)
    failure = record(outcome=Outcome.TIMEOUT)
    assert metrics.step_efficiency(failure) is None and metrics.path_efficiency(failure) is None


def test_path_length_sums_the_legs():
    poses = (Pose(0, 0, 0), Pose(3, 4, 0), Pose(3, 4, 1.57), Pose(3, 5, 0))
    assert records.path_length_m(poses) == pytest.approx(6.0)


def test_summary_of_a_mixed_evaluation():
    records = [
        RECORD,
        record(
            scene="two",
            outcome=Outcome.COLLISION,
            min_clearance_m=0.0,
            remaining_m=15.0,
            decision_ms=(3.0,),
            shield_changes=1,
        ),
        record(scene="three", outcome=Outcome.TIMEOUT, remaining_m=15.0, shield_changes=2),
        record(scene="four", path_m=15.0, steps=20),
    ]
    summary = metrics.summarise(records, np.random.default_rng(0))
    assert (summary["success"], summary["collision"], summary["timeout"]) == (0.5, 0.25, 0.25)
    assert summary["spl"] == pytest.approx((0.75 + 1.0) / 4)
    assert summary["path_efficiency"] == pytest.approx((0.75 + 1.0) / 2)
    assert summary["step_efficiency"] == pytest.approx(0.9)
    assert summary["shield_changed_share"] == pytest.approx(3 / 76)
    assert summary["min_clearance_m"] == pytest.approx(0.3)
    assert summary["decision_ms"]["p50"] == 1.0 and summary["decision_ms"]["p99"] > 1.0
    for name, (low, high) in summary["confidence_95"].items():
        assert low <= summary[name] <= high, name
    assert [row["scene"] for row in summary["per_scene"]] == ["one", "two", "three", "four"]
    assert set(summary["per_scene"][0]) == {"scene", "outcome", "steps", "path_m", "shortest_m", "min_clearance_m"}
    json.dumps(summary, allow_nan=False)


def test_scenes_in_which_something_moves_are_left_out_of_spl():
    moving = record(static=False, path_m=60.0)
    assert metrics.summarise([RECORD, moving], np.random.default_rng(0))["spl"] == pytest.approx(0.75)
    alone = metrics.summarise([moving], np.random.default_rng(0))
    assert alone["spl"] is None and "spl" not in alone["confidence_95"]


MEASURES = (metrics.spl, metrics.soft_spl, metrics.path_efficiency, metrics.step_efficiency)
UNKNOWN = {"shortest_m": None, "fewest_steps": None, "remaining_m": None}


@pytest.mark.parametrize("outcome", list(Outcome))
def test_a_scene_without_a_known_way_has_no_figure_of_lengths_and_does_not_change_those_of_others(outcome):
    unknown = record(**UNKNOWN, outcome=outcome, path_m=60.0)
    assert [measure(unknown) for measure in MEASURES] == [None] * 4
    both = metrics.summarise([RECORD, unknown], np.random.default_rng(0))
    assert both["spl"] == both["soft_spl"] == both["path_efficiency"] == pytest.approx(0.75)
    alone = metrics.summarise([unknown], np.random.default_rng(0))
    assert [alone[measure.__name__] for measure in MEASURES] == [None] * 4
    assert {measure.__name__ for measure in MEASURES}.isdisjoint(alone["confidence_95"])
    json.dumps(alone, allow_nan=False)


@pytest.mark.parametrize(("steps", "path_m"), [(0, 0.0), (1, 0.3), (7, 2.1)])
def test_a_start_within_the_goals_radius_counts_as_reached_by_the_shortest_way(steps, path_m):
    there = record(shortest_m=0.0, fewest_steps=0, remaining_m=0.0, steps=steps, path_m=path_m)
    assert [measure(there) for measure in MEASURES] == [1.0] * 4
    failed = dataclasses.replace(there, outcome=Outcome.COLLISION)
    assert [measure(failed) for measure in MEASURES] == [0.0, 0.0, None, None]


def test_an_evaluation_without_a_decision_has_no_decision_time():
    summary = metrics.summarise([record(decision_ms=(), steps=0)], np.random.default_rng(0))
    assert summary["decision_ms"] == {"p50": None, "p99": None} and summary["shield_changed_share"] == 0.0
    json.dumps(summary, allow_nan=False)


@pytest.mark.parametrize("outcome", list(Outcome))
def test_one_episode_gives_every_figure_that_it_can(outcome):
    summary = metrics.summarise([record(outcome=outcome)], np.random.default_rng(0))
    for name, (low, high) in summary["confidence_95"].items():
        assert 0 <= low <= summary[name] <= high, name
    json.dumps(summary, allow_nan=False)


def test_no_episodes_have_no_summary():
    with pytest.raises(ValueError, match="no episodes"):
        metrics.summarise([], np.random.default_rng(0))


@pytest.mark.parametrize("repeats", [2, 5])
def test_a_repeated_scene_narrows_no_interval(repeats):
    once = [RECORD, record(outcome=Outcome.COLLISION), record(path_m=40.0)]
    scenes = ["a", "b", "c"]

    def figures(times):
        return metrics.summarise_scenes(once * times, scenes * times, np.random.default_rng(0))

    alone, repeated = figures(1), figures(repeats)
    assert repeated["confidence_95"]["success"] == alone["confidence_95"]["success"]
    widths = [high - low for low, high in (figure["confidence_95"]["spl"] for figure in (alone, repeated))]
    assert widths[1] == pytest.approx(widths[0], rel=0.1)
    assert repeated["distinct_scenes"] == 3 and repeated["success"] == alone["success"]


def test_scenes_that_differ_have_the_figures_of_their_episodes():
    episodes = [RECORD, record(outcome=Outcome.COLLISION)]
    figures = metrics.summarise_scenes(episodes, ["a", "b"], np.random.default_rng(0))
    assert figures == metrics.summarise(episodes, np.random.default_rng(0)) | {"distinct_scenes": 2}
