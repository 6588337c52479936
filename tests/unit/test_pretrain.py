import json
import sys

import pytest

from zsdist import pretrain
from zsdist.config import CameraConfig
from zsdist.sim.manifest import OOD_FAMILIES
from zsdist.vision.folder import METADATA_FILE

KEYS = {"best_action_accuracy", "regret", "mae", "miss_rate", "false_alarm_rate"}
CAMERA = CameraConfig(size_px=64)


def command(*arguments):
    return pretrain.main(pretrain.make_parser().parse_args([str(argument) for argument in arguments]))


def test_a_few_pictures_make_weights_that_a_check_takes(tmp_path, capsys, monkeypatch):
    out = tmp_path / "weights"
    monkeypatch.setattr(sys, "argv", ["pretrain", "--images", "32"])
    assert command("--images", 32, "--epochs", 2, "--out", out, "--seed", 5) == 0
    metadata = json.loads((out / METADATA_FILE).read_text())
    assert metadata["images"] == 32 and metadata["seed"] == 5 and "--images 32" in metadata["command"]
    assert set(metadata["families"]).isdisjoint(OOD_FAMILIES)
    assert "epoch   2" in capsys.readouterr().out
    assert command("--check", "--images", 8, "--set", f"vision.weights={out}") == 0


@pytest.mark.parametrize("wrong", [("--images", "0"), ("--minutes", "-1"), ("--epochs", "many"), ("--seed", "-1")])
def test_options_outside_their_range_are_refused_in_one_line(wrong, capsys):
    with pytest.raises(SystemExit) as left:
        command(*wrong)
    assert left.value.code == 2 and capsys.readouterr().err.count("\n") == 1
