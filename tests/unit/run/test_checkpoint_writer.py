import threading

import numpy as np
import pytest

from zsdist import config
from zsdist.errors import WeightsError
from zsdist.run import checkpoint_files, checkpoint_writer, directory, policies, program
from zsdist.run.directory import RunDirectory
from zsdist.types import Level
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire.messages import State

VISION = VisionIdentity("clip/b", "a" * 64, "head", "b" * 64)
SETTINGS = config.load(None, ("low.hidden=[8]", "high.hidden=[8]"))


@pytest.fixture
def folder(tmp_path):
    return directory.create(tmp_path / "run", SETTINGS)


def states(value=0.0):
    """Return states of both learners whose present networks differ from the winners of a merge."""
    made = {"scheduler": State("scheduler", {"finished": [1], "wall_s": 1.0}, {})}
    for level in Level:
        dqn = program.make_learner(SETTINGS, level)
        arrays = {f"dqn/{name}": array for name, array in dqn.state().items()}
        arrays |= {f"best/{name}": np.full_like(array, value) for name, array in dqn.parameters().items()}
        made[f"learner-{level}"] = State(f"learner-{level}", {}, arrays)
    return made


def names(folder):
    return [int(path.name) for path in checkpoint_files.checkpoints(folder)]


def small():
    return {"scheduler": State("scheduler", {"finished": [1], "wall_s": 1.0}, {})}


@pytest.mark.parametrize("kept", [1, 3])
def test_the_newest_checkpoints_and_the_best_one_are_kept(folder, kept):
    run_log = RunDirectory(folder, VISION, kept=kept)
    scores = [None, 0.2, 0.7, 0.7, 0.1, -0.3, 0.4, 0.5, 0.6]
    for episodes, score in enumerate(scores):
        run_log.checkpoint(episodes, small(), score)
        newest = list(range(max(0, episodes + 1 - kept), episodes + 1))
        scored = [(value, number) for number, value in enumerate(scores[: episodes + 1]) if value is not None]
        best = max(scored)[1] if scored else None
        assert names(folder) == sorted({*newest, *([best] if scored else [])})
        assert best is None or int(checkpoint_writer.find_best(folder).name) == best


def test_checkpoints_of_earlier_versions_and_damaged_ones_have_no_score(folder):
    run_log = RunDirectory(folder, VISION)
    run_log.checkpoint(1, small(), 0.9)
    run_log.checkpoint(2, small(), 0.1)
    run_log.checkpoint(3, small())
    (folder / "checkpoints" / "00000001" / "manifest.json").write_text("{")
    assert int(checkpoint_writer.find_best(folder).name) == 2


def test_the_best_policy_is_the_network_that_won_the_best_merge_and_the_newest_is_used_unless_it_is_asked_for(folder):
    run_log = RunDirectory(folder, VISION)
    run_log.checkpoint(1, states(1.0), 0.8)
    run_log.checkpoint(2, states(2.0), 0.4)
    best = policies.load_by_name(str(folder / "checkpoints" / "best"), ())
    assert best.source.endswith("00000001")
    assert all((array == 1.0).all() for level in Level for array in best.parameters[level].values())
    newest = policies.load_by_name(str(folder), ())
    assert newest.source.endswith("00000002")
    assert not any((array == 2.0).all() for array in newest.parameters[Level.LOW].values())


def test_a_run_without_a_merge_has_no_best_policy(folder):
    RunDirectory(folder, VISION).checkpoint(1, states())
    with pytest.raises(WeightsError, match=r"no checkpoint in .* has a score"):
        policies.load_by_name(str(folder / "checkpoints" / "best"), ())


def test_a_checkpoint_is_written_beside_lines_that_are_added_and_holds_none_of_them(folder):
    run_log = RunDirectory(folder, VISION)
    row = {"return": 1.0, "steps": 7, "epsilon": 0.5}
    run_log.episode({"finished_as": 1, **row})
    write = run_log.begin_checkpoint(1, small())
    for number in range(2, 5):
        run_log.episode({"finished_as": number, **row})
    thread = threading.Thread(target=write)
    thread.start()
    run_log.metrics({"time_s": 1.0, "env_steps": 3})
    thread.join()
    (checkpoint,) = checkpoint_files.checkpoints(folder)
    before = checkpoint_files.read_manifest(checkpoint)["tensorboard"]
    directory.rewind(folder, SETTINGS, checkpoint_files.read_checkpoint(checkpoint))
    assert {path.name: path.stat().st_size for path in (folder / "tensorboard").iterdir()} == before
    assert len((folder / "episodes.jsonl").read_text().splitlines()) == 1


def test_a_checkpoint_that_was_never_finished_is_not_believed(folder):
    run_log = RunDirectory(folder, VISION)
    run_log.checkpoint(1, small())
    run_log.begin_checkpoint(2, small())
    partial = folder / "checkpoints" / ".00000002.partial"
    partial.mkdir()
    (partial / "scheduler.state").write_bytes(b"half")
    assert names(folder) == [1]
    run_log.checkpoint(2, small())
    assert names(folder) == [1, 2] and not partial.exists()
