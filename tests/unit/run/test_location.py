"""What people paste for a run: the run, a checkpoint, or a file in either."""

import contextlib

import pytest
from made_runs import make_run

from zsdist import config
from zsdist.errors import RunError, WeightsError
from zsdist.evaluation import comparison
from zsdist.reporting import runs
from zsdist.run import directory, location, opening, program
from zsdist.run.checkpoint import load_policy
from zsdist.run.directory import RunDirectory
from zsdist.types import Level
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire.messages import State

VISION = VisionIdentity("clip/b", "a" * 64, "head", "b" * 64)
SETTINGS = config.load(None, ("low.hidden=[8]", "high.hidden=[8]"))
INSIDE = ("", "/", "/config.yaml", "/checkpoints", "/checkpoints/00000002", "/checkpoints/00000002/manifest.json")


@pytest.fixture
def folder(tmp_path):
    """Return a run with a space in its name and checkpoints of 1 and 2 episodes."""
    folder = directory.create(tmp_path / "my runs" / "one", SETTINGS)
    arrays = {level: program.make_learner(SETTINGS, level).state() for level in Level}
    states = {
        f"learner-{level}": State(f"learner-{level}", {}, {f"dqn/{name}": array for name, array in parts.items()})
        for level, parts in arrays.items()
    }
    for episodes in (1, 2):
        finished = list(range(1, episodes + 1))
        states["scheduler"] = State("scheduler", {"finished": finished, "wall_s": 1.0}, {})
        RunDirectory(folder, VISION).checkpoint(episodes, states)
    return folder


def resume(path, monkeypatch):
    monkeypatch.setattr(opening, "check_parts", lambda settings, notify: VISION)
    with contextlib.ExitStack() as held:
        return opening.open_resumed(path, ("run.episodes=9",), lambda line: None, held)


@pytest.mark.parametrize("inside", INSIDE)
def test_a_run_is_found_from_everything_in_it(folder, inside, monkeypatch):
    path = type(folder)(f"{folder}{inside}")
    assert resume(path, monkeypatch).folder == folder.resolve()
    assert load_policy(path).source == str(folder / "checkpoints" / "00000002")


@pytest.mark.parametrize("inside", INSIDE)
def test_it_is_found_by_a_relative_path_too(folder, inside, monkeypatch):
    monkeypatch.chdir(folder / "checkpoints")
    path = type(folder)(f"../../one{inside}")
    assert resume(path, monkeypatch).folder == folder.resolve()
    monkeypatch.chdir(folder / "checkpoints" / "00000002")
    assert load_policy(type(folder)(".")).config.low == SETTINGS.low


def test_an_older_checkpoint_is_evaluated_and_not_resumed(folder, monkeypatch):
    older = folder / "checkpoints" / "00000001"
    assert load_policy(older / "learner-low.state").source == str(older)
    with pytest.raises(RunError, match=r"is in checkpoint 00000001, .* its newest, 00000002; .*move the later ones"):
        resume(older, monkeypatch)


def test_a_checkpoint_that_is_not_there_is_refused_with_those_that_are(folder):
    with pytest.raises(RunError, match="the checkpoints of that run are 00000001, 00000002"):
        directory.check_is_run(folder / "checkpoints" / "99999999")


def test_a_folder_of_runs_is_refused_with_the_name_of_one(folder, monkeypatch):
    with pytest.raises(RunError, match=rf"holds no run.*; it holds runs, such as {folder}"):
        resume(folder.parent, monkeypatch)


def test_a_path_outside_a_run_is_left_as_it_is(tmp_path):
    for path in (tmp_path, tmp_path / "nowhere"):
        assert location.find_run(path) == path and location.find_checkpoint(path) is None


@pytest.mark.parametrize("inside", ["", "/config.yaml", "/episodes.jsonl", "/summary.json"])
def test_a_report_takes_them_too(tmp_path, inside):
    folder = make_run(tmp_path / "run", summary={})
    assert [run.folder for run in runs.read([type(folder)(f"{folder}{inside}")]).runs] == [folder]


def test_a_folder_is_no_file_of_episodes(folder):
    with pytest.raises(RunError, match=r"is a folder; allowed is a file that zsdist\.evaluate --out"):
        comparison.compare(folder, folder)


def test_a_policy_is_driven_where_its_weights_are_now(folder, tmp_path):
    kept = (folder / "config.yaml").read_text().replace("weights: pretrained", "weights: eyes")
    (folder / "config.yaml").write_text(kept)
    with pytest.raises(WeightsError, match=r"vision\.weights 'eyes', a relative path"):
        load_policy(folder)
    assert load_policy(folder, (f"vision.weights={tmp_path}",)).config.vision.weights == str(tmp_path)
