import contextlib
import json

import pytest

from zsdist import config
from zsdist.common import locks
from zsdist.errors import CompleteError, RunError
from zsdist.run import directory, opening
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire.messages import State


@pytest.mark.parametrize(("ended", "wanted"), [("complete", 3), ("interrupted", 2), (None, 2)])
def test_a_run_is_resumed_unless_its_episodes_and_what_follows_them_are_complete(tmp_path, monkeypatch, ended, wanted):
    folder = directory.create(tmp_path / "run", config.Config())
    vision = VisionIdentity("clip/b", "a" * 64, "head", "b" * 64)
    state = State("scheduler", {"finished": [1, 2], "wall_s": 0.0}, {})
    directory.RunDirectory(folder, vision).checkpoint(2, {"scheduler": state})
    if ended:
        (folder / "summary.json").write_text(json.dumps({"ended": ended}))
    monkeypatch.setattr(opening.preflight, "check_shards", lambda settings, states: None)
    monkeypatch.setattr(opening, "check_parts", lambda settings, notify: vision)

    def resumed_episodes(episodes):
        overrides = (f"run.episodes={episodes}",)
        with contextlib.ExitStack() as held:
            return opening.open_resumed(folder, overrides, lambda line: None, held).config.run.episodes

    with pytest.raises(RunError, match="has finished 2 episodes") as refused:
        resumed_episodes(wanted - 1)
    assert isinstance(refused.value, CompleteError) == (ended == "complete")
    assert resumed_episodes(wanted) == wanted


@pytest.fixture
def parts(monkeypatch):
    """Vision model of this machine, found by checks that cost nothing."""
    vision = VisionIdentity("clip/b", "a" * 64, "head", "b" * 64)
    monkeypatch.setattr(opening, "check_parts", lambda settings, notify: vision)
    return vision


def content(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_run_that_ended_before_its_first_checkpoint_begins_anew(tmp_path, parts):
    folder = directory.create(tmp_path / "run", config.Config())
    directory.issue_epochs(folder, 3)
    (folder / "episodes.jsonl").write_text(json.dumps({"episode": 1}) + "\n")
    (folder / "metrics.jsonl").write_text(json.dumps({"episodes": 1}) + "\n")
    lines = []
    with contextlib.ExitStack() as held:
        spec = opening.open_resumed(folder, ("run.episodes=7",), lines.append, held)
    assert (spec.states, spec.config.run.episodes) == ({}, 7)
    assert (folder / "episodes.jsonl").read_text() == (folder / "metrics.jsonl").read_text() == ""
    assert "ended before its first checkpoint; it begins anew" in lines[0]


@pytest.mark.parametrize("resume", [True, False])
def test_a_run_that_is_in_use_is_refused_before_anything_is_checked_or_written(tmp_path, monkeypatch, resume):
    folder = directory.create(tmp_path / "run", config.Config())
    monkeypatch.setattr(opening, "check_parts", lambda settings, notify: pytest.fail("too late"))
    with locks.held(folder, "run"), contextlib.ExitStack() as held:
        before = content(folder)
        with pytest.raises(RunError, match=f"run directory {folder} is in use by process"):
            if resume:
                opening.open_resumed(folder, (), lambda line: None, held)
            else:
                opening.open_new(config.Config(), folder, lambda line: None, held)
        assert content(folder) == before


def test_of_two_new_runs_in_one_folder_the_slower_is_refused(tmp_path, monkeypatch, parts):
    folder = tmp_path / "run"
    with contextlib.ExitStack() as first, contextlib.ExitStack() as second:

        def faster(settings, notify):
            monkeypatch.setattr(opening, "check_parts", lambda settings, notify: parts)
            opening.open_new(config.Config(), folder, lambda line: None, first)
            return parts

        monkeypatch.setattr(opening, "check_parts", faster)
        with pytest.raises(RunError, match=r"is in use by process|holds a run already"):
            opening.open_new(config.Config(), folder, lambda line: None, second)


def test_a_run_holds_its_lock_as_long_as_its_launcher_wants(tmp_path, parts):
    with contextlib.ExitStack() as held:
        spec = opening.open_new(config.Config(), tmp_path / "run", lambda line: None, held)
        with pytest.raises(RunError, match="is in use"):
            locks.check_free(spec.folder, "run")
    locks.check_free(spec.folder, "run")
