import errno
import json
import os
import shutil

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.util.tensor_util import make_ndarray

from zsdist import config
from zsdist.errors import RunError, WeightsError
from zsdist.run import checkpoint_files, directory
from zsdist.run.checkpoint import load_policy
from zsdist.run.directory import RunDirectory
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire.messages import State

VISION = VisionIdentity("clip/b", "a" * 64, "head", "b" * 64)
META = {"finished": [1, 2, 4], "wall_s": 3.0}


@pytest.fixture
def folder(tmp_path):
    return directory.create(tmp_path / "run", config.Config())


@pytest.fixture
def run_log(folder):
    return RunDirectory(folder, VISION)


def states(value=1.0):
    return {"scheduler": State("scheduler", META, {}), "replay": State("replay", {}, {"ring": np.full(3, value)})}


def test_tensorboard_finds_settings_episodes_and_metrics(folder, run_log):
    run_log.show_settings(config.Config())
    for number in (1, 2):
        run_log.episode({"finished_as": number, "return": 10.0 * number, "steps": 7, "epsilon": 0.5})
    run_log.metrics({"time_s": 1.0, "env_steps": 14, "low_loss": 0.25, "stage": "train"})
    run_log.summary({})
    events = EventAccumulator(str(folder / "tensorboard")).Reload()

    def curve(tag):
        return [(event.step, float(make_ndarray(event.tensor_proto))) for event in events.Tensors(tag)]

    assert curve("episode/return") == [(1, 10.0), (2, 20.0)]
    assert curve("low/loss") == [(14, 0.25)]
    assert set(events.Tags()["tensors"]) == {
        "configuration", "_hparams_/session_start_info",
        "episode/return", "episode/steps", "episode/epsilon", "run/env_steps", "low/loss",
    }  # fmt: skip
    summary = events.SummaryMetadata("low/loss")
    assert summary.plugin_data.plugin_name == "scalars"


def test_epochs_are_never_issued_twice(folder):
    issued = [epoch for count in (3, 1, 5) for epoch in directory.issue_epochs(folder, count)]
    assert issued == list(range(issued[0], issued[0] + 9))


def test_epochs_of_two_runs_have_nothing_in_common(tmp_path):
    runs = [directory.create(tmp_path / name, config.Config()) for name in ("one", "other")]
    one, other = (set(directory.issue_epochs(folder, 1000)) for folder in runs)
    assert not one & other
    assert max(one | other) < 2**53  # exact also for readers of JSON that know floats alone


def test_a_checkpoint_reads_back_as_it_was_written_and_the_newest_wins(folder, run_log):
    for episodes in (5, 10, 100):
        run_log.checkpoint(episodes, states(episodes))
    newest = checkpoint_files.newest_checkpoint(folder)
    assert newest.name == "00000100"
    read = checkpoint_files.read_checkpoint(newest)
    assert read["scheduler"].meta == META
    np.testing.assert_array_equal(read["replay"].arrays["ring"], np.full(3, 100.0))


def test_a_checkpoint_names_the_vision_model_of_its_policy(folder, run_log):
    run_log.checkpoint(5, states())
    assert checkpoint_files.read_vision(checkpoint_files.newest_checkpoint(folder)) == VISION


@pytest.mark.parametrize("vision", [None, {"encoder": "clip/b"}, "clip/b"])
def test_a_checkpoint_that_names_no_vision_model_is_refused(folder, run_log, vision):
    run_log.checkpoint(5, states())
    path = checkpoint_files.newest_checkpoint(folder) / "manifest.json"
    manifest = json.loads(path.read_text()) | {"vision": vision}
    del manifest["manifest_sha256"]
    path.write_bytes(checkpoint_files.manifest_bytes(manifest))
    with pytest.raises(RunError, match="does not name the vision model"):
        checkpoint_files.read_vision(path.parent)
    with pytest.raises(WeightsError, match="does not name the vision model"):
        load_policy(folder)


def test_only_the_newest_checkpoints_are_kept(folder, run_log):
    for episodes in range(10):
        run_log.checkpoint(episodes, states())
    kept = sorted(path.name for path in (folder / "checkpoints").iterdir())
    assert kept == ["00000007", "00000008", "00000009"]


@pytest.mark.parametrize(
    "damage", [lambda data: data[:-1], lambda data: data[:20] + b"x" + data[21:], lambda data: b""]
)
def test_a_damaged_checkpoint_is_refused_by_file(folder, run_log, damage):
    run_log.checkpoint(1, states())
    file = folder / "checkpoints" / "00000001" / "replay.state"
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(RunError, match=r"replay\.state is damaged"):
        checkpoint_files.read_checkpoint(file.parent)


def test_a_checkpoint_without_a_file_is_refused_by_file(folder, run_log):
    run_log.checkpoint(1, states())
    (folder / "checkpoints" / "00000001" / "replay.state").unlink()
    with pytest.raises(RunError, match=r"replay\.state"):
        checkpoint_files.read_checkpoint(folder / "checkpoints" / "00000001")


def test_a_resume_prunes_episodes_that_the_checkpoint_does_not_contain(folder, run_log):
    for finished_as, episode in enumerate((1, 2, 4, 3, 5), 1):
        run_log.episode({"episode": episode, "return": 0.0, "steps": 1, "epsilon": 1.0, "finished_as": finished_as})
    with (folder / "episodes.jsonl").open("a") as file:
        file.write('{"episode": 6, "retu')  # left by a killed process
    run_log.checkpoint(3, states())
    settings, read = directory.reopen(folder)
    directory.rewind(folder, settings, read)
    lines = (folder / "episodes.jsonl").read_text().splitlines()
    assert [json.loads(line)["episode"] for line in lines] == META["finished"]


def test_a_resume_prunes_later_figures_and_an_unfinished_line(folder, run_log):
    rows = [{"time_s": 0.0}, *({"time_s": 1.0, "episodes": count, "env_steps": count} for count in (1, 3, 4, 6))]
    for row in rows:
        run_log.metrics(row)
    with (folder / "metrics.jsonl").open("a") as file:
        file.write('{"time_s": 2.0, "epi')
    run_log.checkpoint(3, states())
    directory.rewind(folder, *directory.reopen(folder))
    lines = (folder / "metrics.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in lines] == [{"row": number} | row for number, row in enumerate(rows[:3])]


def test_a_resume_removes_the_events_of_the_board_that_came_after_the_checkpoint(folder, run_log):
    def record(number):
        return {"episode": number, "return": 0.0, "steps": 1, "epsilon": 1.0, "finished_as": number}

    def steps(tag):
        return [event.step for event in EventAccumulator(str(folder / "tensorboard")).Reload().Tensors(tag)]

    for number in (1, 2, 3, 4, 5):
        run_log.episode(record(number))
        run_log.metrics({"episodes": number, "env_steps": number})
        if number == 3:
            run_log.checkpoint(3, states())
    directory.rewind(folder, *directory.reopen(folder))
    never_saved = RunDirectory(folder, VISION)  # a start that is killed before its first checkpoint
    never_saved.metrics({"episodes": 4, "env_steps": 40})
    (folder / "tensorboard" / "notes.txt").write_text("not ours")
    directory.rewind(folder, *directory.reopen(folder))
    resumed = RunDirectory(folder, VISION)
    resumed.episode(record(4))
    resumed.metrics({"episodes": 4, "env_steps": 400})
    assert steps("episode/return") == [1, 2, 3, 4]
    assert steps("run/env_steps") == [1, 2, 3, 400]
    assert (folder / "tensorboard" / "notes.txt").exists()


def test_a_rewind_reads_only_what_came_after_the_checkpoint(folder, run_log, monkeypatch):
    run_log.checkpoint(3, states())
    for name, line in (("episodes", '{"finished_as": 1}'), ("metrics", '{"episodes": 1}')):
        (folder / f"{name}.jsonl").write_text(f"{line}\n" * 100_000 + line.replace("1", "9") + "\n")
    read, states_read = [], directory.reopen(folder)
    monkeypatch.setattr(json, "loads", lambda text, loads=json.loads: read.append(len(text)) or loads(text))
    directory.rewind(folder, *states_read)
    assert len(read) < 10
    assert (folder / "metrics.jsonl").read_text().count("\n") == 100_000


def test_hidden_and_foreign_folders_are_no_checkpoints(folder, run_log):
    run_log.checkpoint(3, states())
    checkpoints = folder / "checkpoints"
    for name in (".00000009.partial", ".DS_Store", "00000008 copy", "99999999-mine", "٣"):
        shutil.copytree(checkpoints / "00000003", checkpoints / name)
    (checkpoints / "00000007").mkdir()  # without a manifest
    assert checkpoint_files.newest_checkpoint(folder).name == "00000003"
    for count in (4, 5, 6):
        run_log.checkpoint(count, states())
    assert not (checkpoints / "00000003").exists()
    assert (checkpoints / "00000008 copy").exists() and (checkpoints / "99999999-mine").exists()


def test_checkpoints_are_in_order_of_their_numbers_beyond_eight_digits(folder, run_log):
    for count in (99_999_998, 99_999_999, 100_000_000, 100_000_001):
        run_log.checkpoint(count, states())
    assert [path.name for path in checkpoint_files.checkpoints(folder)] == ["99999999", "100000000", "100000001"]


def test_folders_that_a_copy_of_a_run_lacks_are_made_when_it_is_resumed(folder, run_log):
    run_log.checkpoint(3, states())
    for name in ("figures", "logs"):
        (folder / name).rmdir()
    directory.rewind(folder, *directory.reopen(folder))
    assert (folder / "figures").is_dir() and (folder / "logs").is_dir()


@pytest.mark.parametrize("change", ["seed=4", "grid.blocks=8", "high.hidden=[64]", "low.hidden=[64]"])
def test_a_change_of_a_fixed_setting_is_refused_by_name_and_changes_nothing(folder, run_log, change):
    run_log.checkpoint(3, states())
    before = (folder / "config.yaml").read_bytes()
    with pytest.raises(RunError, match=rf"{change.partition('=')[0]} is .*; allowed is the run's original value"):
        directory.reopen(folder, (change,))
    assert (folder / "config.yaml").read_bytes() == before


def test_a_run_with_a_damaged_newest_checkpoint_is_resumed_from_the_one_before_and_says_so(folder, run_log):
    for count in (1, 2, 3):
        run_log.checkpoint(count, states(count))
    newest, lines = folder / "checkpoints" / "00000003", []
    (newest / "replay.state").write_bytes(b"")
    _, read = directory.reopen(folder, (), lines.append)
    np.testing.assert_array_equal(read["replay"].arrays["ring"], np.full(3, 2.0))
    (line,) = lines
    assert line.startswith(f"checkpoint file {newest / 'replay.state'} is damaged")
    assert line.endswith("the one before it is used, 00000002")
    assert [path.name for path in checkpoint_files.checkpoints(folder)] == ["00000001", "00000002"]
    assert (folder / "checkpoints" / "00000003.damaged" / "manifest.json").is_file()  # for people to look at
    directory.rewind(folder, directory.reopen(folder, (), lines.append)[0], read)
    assert len(lines) == 1
    for count in (3, 4, 5):
        run_log.checkpoint(count, states(count))
    assert [path.name for path in checkpoint_files.checkpoints(folder)] == ["00000003", "00000004", "00000005"]


def test_a_checkpoint_replaces_one_of_the_same_count(folder, run_log):
    run_log.checkpoint(3, states(1.0))
    left_over = folder / "checkpoints" / ".00000003.old"  # of a process killed at the same point
    left_over.mkdir()
    (left_over / "replay.state").touch()
    run_log.checkpoint(3, states(2.0))
    (only,) = (folder / "checkpoints").iterdir()
    np.testing.assert_array_equal(checkpoint_files.read_checkpoint(only)["replay"].arrays["ring"], np.full(3, 2.0))


@pytest.mark.parametrize(("summary", "ended"), [('{"ended": "complete"}', "complete"), (None, None)])
def test_the_end_of_a_run_is_read_from_its_summary(folder, summary, ended):
    if summary:
        (folder / "summary.json").write_text(summary)
    assert directory.ended(folder) == ended


@pytest.mark.parametrize("summary", ["", "[]", "{}"])
def test_an_invalid_summary_is_refused(folder, summary):
    (folder / "summary.json").write_text(summary)
    with pytest.raises(RunError, match="is not a run's summary"):
        directory.ended(folder)


def test_the_configuration_comes_back_with_overrides_and_nothing_else_changed(folder, run_log):
    run_log.checkpoint(3, states())
    settings, _ = directory.reopen(folder, ("run.episodes=7",))
    assert settings.run.episodes == 7
    assert config.parse(settings.model_dump() | {"run": config.Config().run.model_dump()}) == config.Config()


def test_a_policy_without_weights_is_refused(folder, run_log):
    with pytest.raises(WeightsError, match="no weights"):
        load_policy(folder)
    run_log.checkpoint(1, states())
    with pytest.raises(WeightsError, match="high"):
        load_policy(folder)


@pytest.mark.parametrize(("name", "key"), [("plain-1.2", "plain-1.2"), ("with space/ä", "-")])
def test_every_folder_gets_a_name_that_is_valid_in_keys(tmp_path, name, key):
    (tmp_path / name).mkdir(parents=True)
    assert directory.key_name(tmp_path / name) == key


def test_a_folder_whose_name_is_no_utf_8_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(RunError, match="UTF-8"):
        directory.create(tmp_path / "x\udcff" / "run", config.Config())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("file", ["episodes.jsonl", "metrics.jsonl"])
def test_a_full_disk_ends_lines_in_one_line(folder, file):
    (folder / file).symlink_to("/dev/full")
    run_log = RunDirectory(folder, VISION)
    with pytest.raises(RunError, match=f"run directory {folder} cannot be written: No space left on device"):
        if file == "episodes.jsonl":
            run_log.episode({"finished_as": 1, "return": 1.0, "steps": 7, "epsilon": 0.5})
        else:
            run_log.metrics({"time_s": 1.0})
    (folder / file).unlink()  # with the file open at the end, Python would report what it still holds back
    (folder / file).touch()


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EIO])
def test_a_checkpoint_that_the_disk_does_not_take_is_one_line_and_leaves_those_before(
    folder, run_log, monkeypatch, number
):
    run_log.checkpoint(1, states())
    before = {path for path in folder.rglob("*")}

    def fail(descriptor):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fail)
    for write in (
        lambda: run_log.checkpoint(2, states()),
        lambda: run_log.summary({}),
        lambda: directory.issue_epochs(folder, 1),
    ):
        with pytest.raises(RunError, match=f"run directory {folder} cannot be written: {os.strerror(number)}"):
            write()
    assert {path for path in folder.rglob("*")} == before


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(RunError, match=r"run directory .* cannot be written: Not a directory"):
        RunDirectory(tmp_path / "file", VISION)


def test_a_folder_that_the_disk_does_not_take_whole_is_not_left_behind(tmp_path, monkeypatch):
    def fail(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(RunError, match=r"run directory .*/run cannot be written: No space left on device"):
        directory.create(tmp_path / "run", config.Config())
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_locked_is_not_left_behind(tmp_path):
    def refuse(folder):
        raise RunError(f"{folder} cannot be locked: No space left on device")

    with pytest.raises(RunError, match="cannot be locked"):
        directory.create(tmp_path / "runs" / "run", config.Config(), lock=refuse)
    assert list(tmp_path.iterdir()) == []
