"""A policy drives with the encoder that it was trained with, and with no other."""

import contextlib
from dataclasses import replace

import pytest
from rehearsal import SEEN, kinematic

from zsdist import config
from zsdist.errors import WeightsError
from zsdist.run import directory, opening, program
from zsdist.run.checkpoint import check_vision, load_policy
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
    """Return a function that writes the checkpoint of a run trained with a given vision model."""

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


def note_on(folder):
    return check_vision(load_policy(folder))


def test_a_policy_with_its_own_vision_model_is_loaded_without_a_note(trained, here):
    assert note_on(trained(here)) is None


@pytest.mark.parametrize("change", [{"encoder": "clip/b", "encoder_sha256": "0" * 64}, {"encoder_sha256": "0" * 64}])
def test_a_policy_of_another_encoder_is_refused_in_one_line(trained, here, change):
    with pytest.raises(WeightsError, match="was trained on encoder") as refused:
        note_on(trained(replace(here, **change)))
    assert here.encoder in str(refused.value) and "\n" not in str(refused.value)


def test_another_head_is_reported_in_one_line(trained, here):
    note = note_on(trained(replace(here, weights_sha256="0" * 64)))
    assert "\n" not in note and "trained with head 0000000000000000" in note


def resumed(folder, monkeypatch, seen, notify=lambda line: None):
    monkeypatch.setattr(opening, "check_parts", lambda settings, notify: seen)
    with contextlib.ExitStack() as held:
        return opening.open_resumed(folder, (), notify, held)


def test_a_run_is_not_resumed_on_another_encoder(trained, monkeypatch):
    folder = trained(SEEN)
    with pytest.raises(WeightsError, match="trained on encoder 'fake'"):
        resumed(folder, monkeypatch, replace(SEEN, encoder_sha256="0" * 64))
    assert resumed(folder, monkeypatch, SEEN).vision == SEEN


def test_resuming_with_another_head_is_reported(trained, monkeypatch):
    seen, lines = replace(SEEN, weights_sha256="d" * 64), []
    assert resumed(trained(SEEN), monkeypatch, seen, lines.append).vision == seen
    assert "now uses head dddd" in lines[-1]


def test_an_actor_with_another_vision_model_than_its_run_is_refused(tmp_path):
    spec = RunSpec(SETTINGS, "run", tmp_path, {}, replace(SEEN, weights_sha256="d" * 64), kinematic)
    with pytest.raises(WeightsError, match=r"actor-0 has loaded vision model .*; allowed is that of the run"):
        spec.build(RoleSpec("actor", "0", 0), None, None)
