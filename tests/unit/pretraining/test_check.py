import json

import numpy as np
import pytest

from zsdist.config import CameraConfig, Config
from zsdist.errors import WeightsError
from zsdist.pretraining.check import check, wilderness
from zsdist.sim.manifest import OOD_FAMILIES

KEYS = {"best_action_accuracy", "regret", "mae", "miss_rate", "false_alarm_rate"}
CAMERA = CameraConfig(size_px=64)


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    out = tmp_path_factory.mktemp("check") / "figures.json"
    check(Config(), 112, 3, out)
    return json.loads(out.read_text())


def test_a_check_gives_the_model_and_three_yardsticks_the_same_figures(checked):
    assert checked["images"] == 112 and checked["seed"] == 3 and checked["ms_per_image"] > 0
    for row in (checked, *(checked[name] for name in ("always_forward", "goal_only", "depth_oracle"))):
        assert {key for key in KEYS if np.isfinite(row[key])} == KEYS
    assert set(checked["families"]) == set(OOD_FAMILIES)


def test_the_shipped_model_beats_those_who_do_not_look_and_not_the_one_who_measures(checked):
    assert checked["best_action_accuracy"] >= 0.70
    assert checked["best_action_accuracy"] > checked["goal_only"]["best_action_accuracy"] + 0.05
    assert checked["best_action_accuracy"] > checked["always_forward"]["best_action_accuracy"] + 0.2
    assert checked["best_action_accuracy"] <= checked["depth_oracle"]["best_action_accuracy"] + 0.02
    assert checked["mae"] < 0.5 * checked["goal_only"]["mae"]


def test_yardsticks_that_see_everything_free_miss_everything_near(checked):
    assert checked["goal_only"]["miss_rate"] == 1.0 and checked["goal_only"]["false_alarm_rate"] == 0.0
    assert checked["depth_oracle"]["miss_rate"] < 0.05 and checked["depth_oracle"]["false_alarm_rate"] < 0.05
    assert checked["miss_rate"] < 0.15


def test_the_wilderness_is_the_same_for_a_seed_and_another_for_another():
    first, again, other = (list(wilderness(16, seed, CAMERA)) for seed in (0, 0, 1))
    assert all((a.image == b.image).all() for a, b in zip(first, again, strict=True))
    assert not any((a.image == b.image).all() for a, b in zip(first, other, strict=True))


def test_a_check_of_missing_weights_names_them():
    with pytest.raises(WeightsError, match="nowhere"):
        check(Config(vision={"weights": "nowhere"}), 4, 0, None)
