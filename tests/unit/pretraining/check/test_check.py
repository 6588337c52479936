import json
import math

import numpy as np
import pytest

from zsdist.config import CameraConfig, Config
from zsdist.errors import RunError, WeightsError
from zsdist.pretraining.check.check import FIGURES, YARDSTICKS, check, summarise_sets, without_nan
from zsdist.pretraining.check.sets import SETS
from zsdist.sim.scenes.manifest import OOD_FAMILIES


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    folder = tmp_path_factory.mktemp("check")
    out, driven = folder / "figures.json", folder / "objects.jsonl"
    check(Config(camera=CameraConfig(size_px=96)), 64, 3, out, 2, driven)
    return json.loads(out.read_text()) | {"lines": driven.read_text().splitlines()}


def test_a_check_gives_the_model_and_three_yardsticks_the_same_figures(checked):
    assert checked["images"] == 64 and checked["seed"] == 3
    assert checked["ms_per_image"]["head"] > 0 and checked["ms_per_image"]["trunk"] > 0
    for row in (checked, *(checked[name] for name in YARDSTICKS)):
        assert all(np.isfinite(row[key]) for key in FIGURES)
    assert set(checked["families"]) == set(OOD_FAMILIES)


def test_each_set_of_pictures_has_its_figures_beside_median_and_worst(checked):
    assert set(checked["sets"]) == {*SETS, "median", "worst"}
    assert checked["sets"]["worst"]["miss_rate"] == max(checked["sets"][name]["miss_rate"] for name in SETS)


def test_the_model_beats_the_yardsticks_that_see_nothing(checked):
    assert checked["best_action_accuracy"] > checked["goal_only"]["best_action_accuracy"] + 0.05
    assert checked["best_action_accuracy"] > checked["always_forward"]["best_action_accuracy"] + 0.2
    assert checked["mae"] < 0.5 * checked["goal_only"]["mae"]


def test_yardsticks_that_see_everything_free_miss_everything_near(checked):
    assert checked["goal_only"]["miss_rate"] == 1.0 and checked["goal_only"]["false_alarm_rate"] == 0.0
    assert checked["depth_oracle"]["miss_rate"] < 0.05 and checked["depth_oracle"]["false_alarm_rate"] < 0.05
    assert checked["miss_rate"] < 0.15


def test_objects_are_counted_in_single_pictures_and_recorded_one_by_one_after_driving_up(checked):
    assert checked["objects"]["one_look"]["objects"] > 50
    low, high = checked["objects"]["one_look"]["confidence_95"]
    assert low <= checked["objects"]["one_look"]["share"] <= high
    assert checked["objects"]["after_drive_up"]["objects"] == len(checked["lines"]) == 2


def test_parts_that_weights_or_options_lack_are_left_out_and_reported(checked):
    for name in ("table3", "attention", "words"):
        assert (name in checked) != (name in checked["left_out"])
    assert "words" in checked["left_out"] or "words.unseen_kinds" in checked["left_out"]
    assert ("student" in checked["ms_per_image"]) != ("ms_per_image.student" in checked["left_out"])


def test_the_worst_calibration_is_the_one_farthest_from_its_share():
    row = {"best_action_accuracy": 0.9, "miss_rate": 0.1, "false_alarm_rate": 0.0, "calibration_10_all_rays": 0.1}
    found = summarise_sets(
        {
            "a": row | {"calibration_10": 0.12},
            "b": row | {"calibration_10": 0.02, "best_action_accuracy": 0.7},
            "c": row | {"calibration_10": math.nan},
        }
    )
    assert found["worst"]["calibration_10"] == 0.02 and found["worst"]["best_action_accuracy"] == 0.7
    assert found["median"]["calibration_10"] == pytest.approx(0.07)


def test_an_unknown_figure_is_left_out_of_the_file():
    assert without_nan({"a": 1.0, "b": {"c": math.nan, "d": 2}}) == {"a": 1.0, "b": {"d": 2}}


def test_a_check_of_missing_weights_names_them():
    with pytest.raises(WeightsError, match="nowhere"):
        check(Config(vision={"weights": "nowhere"}), 4, 0, None)


def test_a_file_that_cannot_be_written_is_refused_before_anything_is_measured(tmp_path):
    with pytest.raises(RunError, match="--json"):
        check(Config(), 10**9, 0, tmp_path / "missing" / "figures.json")
