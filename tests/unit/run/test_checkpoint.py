"""A policy drives with the encoder that it was trained with, and with no other."""

from dataclasses import replace

import pytest
from rehearsal import SEEN, kinematic

from zsdist import config, evaluate, launch
from zsdist.common import cli
from zsdist.errors import WeightsError
from zsdist.run import directory, preflight, program
from zsdist.run.directory import RunDirectory
from zsdist.run.program import RoleSpec, RunSpec
from zsdist.types import Level
from zsdist.wire.messages import State

SETTINGS = config.load(None, ("low.hidden=[8]", "high.hidden=[8]"))


@pytest.fixture(scope="module")
def here():
    return program.vision_here(SETTINGS)


@pytest.fixture
def trained(tmp_path):
    """Writes the checkpoint of a run that was trained with a given vision model."""

    def write(vision):
        folder = directory.create(tmp_path / "run", SETTINGS)
        arrays = {level: program.make_learner(SETTINGS, level).state() for level in Level}
        states = {
            f"learner-{level}": State(f"learner-{level}", {}, {f"dqn/{name}": array for name, array in parts.items()})
            for level, parts in arrays.items()
        }
        states["scheduler"] = State("scheduler", {"finished": [1], "wall_s": 1.0}, {})
        RunDirectory(folder, vision).checkpoint(1, states)
        return folder

    return write


def evaluated(folder, capsys):
    with pytest.raises(SystemExit) as exit_:
        cli.execute(lambda _: evaluate.find_policy(str(folder)) and 0, evaluate.make_parser(), [str(folder)])
    return exit_.value.code, capsys.readouterr().err


def test_a_policy_is_evaluated_with_its_own_encoder_without_a_note(trained, here, capsys):
    assert evaluated(trained(here), capsys) == (0, "")


@pytest.mark.parametrize("change", [{"encoder": "clip/b"}, {"encoder_sha256": "0" * 64}])
def test_a_policy_is_refused_with_another_encoder_in_one_line(trained, here, capsys, change):
    code, complaint = evaluated(trained(replace(here, **change)), capsys)
    assert code == 2 and complaint.count("\n") == 1
    assert "was trained on encoder" in complaint and here.encoder in complaint


def test_another_head_is_noted_in_one_line_and_the_policy_is_evaluated(trained, here, capsys):
    code, note = evaluated(trained(replace(here, weights_sha256="0" * 64)), capsys)
    assert code == 0 and note.count("\n") == 1 and "trained with head 0000000000000000" in note


def resumed(folder, monkeypatch, vision):
    monkeypatch.setattr(preflight, "warm_up", lambda settings: vision)
    return launch._resume(launch.parser().parse_args(["--resume", str(folder)]), launch.Console())


def test_a_run_is_not_resumed_with_another_encoder(trained, monkeypatch):
    folder = trained(SEEN)
    with pytest.raises(WeightsError, match="trained on encoder 'fake'"):
        resumed(folder, monkeypatch, replace(SEEN, encoder_sha256="0" * 64))
    assert resumed(folder, monkeypatch, SEEN).vision == SEEN


def test_a_resume_with_another_head_is_noted(trained, monkeypatch, capsys):
    vision = replace(SEEN, weights_sha256="d" * 64)
    assert resumed(trained(SEEN), monkeypatch, vision).vision == vision
    assert "sees by head dddd" in capsys.readouterr().out


def test_an_actor_with_another_vision_model_than_its_run_is_refused(tmp_path):
    spec = RunSpec(SETTINGS, "run", tmp_path, {}, replace(SEEN, weights_sha256="d" * 64), kinematic)
    with pytest.raises(WeightsError, match=r"actor-0 has loaded vision model .*; allowed is that of the run"):
        spec.build(RoleSpec("actor", "0", 0), None, None)
