import errno
import os

import pytest

from zsdist import config
from zsdist.errors import RunError, TransportError
from zsdist.run import directory, inline, program, training
from zsdist.run.program import RunSpec
from zsdist.wire.messages import State


def test_a_level_that_was_not_trained_is_reported_with_the_reason():
    settings = config.parse({"low": {"min_size": 21_000}})
    summary = {"learner_updates": {"high": 7, "low": 0}, "transitions": {"low": {"stored": 900}}}
    (line,) = training.describe_untrained_levels(summary, settings, {})
    assert "900" in line and "21000 (low.min_size)" in line and "high" not in line


def test_losses_with_damaged_journals_are_told_at_the_end_and_an_earlier_summary_has_none():
    counts = {"produced": 9, "stored": 6, "rejected": 3}
    summary = {"transitions": {"high": counts, "low": counts | {"lost": 3, "lost_rows": 40}}}
    (line,) = training.describe_losses(summary)
    assert "the low level 3 transitions" in line and "40 of its ring" in line


@pytest.mark.parametrize(
    ("now", "setting", "reason"),
    [
        (8, {}, None),
        (7, {"updates_per_insert": 0.01}, "60 transitions were added, for 0.01 updates each"),
        (7, {}, "60 transitions were added, and the run ended before any update"),
        (7, {"min_size": 2000}, "starts at 2000"),
    ],
)
def test_a_resumed_run_that_did_not_train_since_says_so_whatever_it_learned_before(now, setting, reason):
    states = {
        "learner-low": State("learner-low", {"updates": 7}, {}),
        "replay": State("replay", {"low": {"stored": 840}}, {}),
    }
    summary = {"learner_updates": {"low": now}, "transitions": {"low": {"stored": 900}}}
    lines = training.describe_untrained_levels(summary, config.parse({"low": setting}), states)
    if reason is None:
        assert lines == []
    else:
        (line,) = lines
        assert "the low level was not trained since it was resumed" in line and reason in line


def test_transitions_that_are_neither_stored_nor_rejected_are_an_error():
    training.check_accounts({"transitions": {"low": {"produced": 5, "stored": 4, "rejected": 1}}})
    with pytest.raises(RunError, match="level low do not balance"):
        training.check_accounts({"transitions": {"low": {"produced": 5, "stored": 3, "rejected": 1}}})


SETTINGS = config.parse({"placement": "inline", "transport": {"kind": "memory"}})


def failing(error, monkeypatch, begin=lambda folder: None):
    """Let the runner of the next training fail, after `begin` has written to the run directory."""

    def run(spec, epochs, **hooks):
        (spec.folder / "endpoint").write_text("tcp/127.0.0.1:1")
        begin(spec.folder)
        raise error

    monkeypatch.setattr(inline, "run", run)


def train(folder):
    spec = RunSpec(SETTINGS, "run", folder, {}, None)
    return training.train(spec, lambda: False, lambda transport, now: None)


@pytest.mark.parametrize("error", [TransportError("the port is taken"), KeyboardInterrupt(), KeyError("x")])
def test_a_start_that_failed_leaves_no_folder(tmp_path, monkeypatch, error):
    folder = directory.create(tmp_path / "run", SETTINGS)
    failing(error, monkeypatch)
    with pytest.raises(type(error)):
        train(folder)
    assert not folder.exists()


def test_a_start_that_failed_leaves_the_files_of_others(tmp_path, monkeypatch):
    (tmp_path / "figures").mkdir()
    for name in ("notes.txt", "figures/own.png"):
        (tmp_path / name).write_text("mine")
    folder = directory.create(tmp_path, SETTINGS)
    failing(TransportError("the port is taken"), monkeypatch)
    with pytest.raises(TransportError):
        train(folder)
    assert {path.name for path in tmp_path.rglob("*") if path.is_file()} == {"notes.txt", "own.png"}


@pytest.mark.parametrize("file", ["episodes.jsonl", "logs/actor-0.log"])
def test_a_run_that_has_begun_stays_and_its_error_says_how_it_begins_anew(tmp_path, monkeypatch, file):
    folder = directory.create(tmp_path / "run", SETTINGS)
    failing(RunError("actor-0: no"), monkeypatch, lambda folder: (folder / file).write_text("{}"))
    with pytest.raises(RunError, match=f"actor-0: no; begin anew with --resume {folder}"):
        train(folder)
    assert (folder / file).exists()


def test_a_second_start_that_failed_removes_nothing(tmp_path, monkeypatch):
    folder = directory.create(tmp_path / "run", SETTINGS)
    directory.issue_epochs(folder, program.epoch_count(SETTINGS))  # by the first one, which was killed
    failing(RunError("no"), monkeypatch)
    with pytest.raises(RunError, match="begin anew with --resume"):
        train(folder)
    assert (folder / "config.yaml").exists()


def test_a_disk_that_takes_no_more_is_one_line(tmp_path, monkeypatch):
    folder = directory.create(tmp_path / "run", SETTINGS)
    failing(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), monkeypatch)
    with pytest.raises(RunError, match=f"run directory {folder} cannot be written: No space left on device"):
        train(folder)
