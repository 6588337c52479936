import json
import os
import shlex
import shutil
import time

import pytest
from made_runs import make_run

from zsdist import launch
from zsdist.common import locks
from zsdist.errors import RunError
from zsdist.run import life as lives

ENDED = {"ended": "complete", "episodes": 12}


def aged(folder, seconds):
    """Date all files of a run back."""
    then = time.time() - seconds
    for file in folder.iterdir():
        os.utime(file, (then, then))
    return folder


def test_a_run_is_starting_until_it_has_a_hub_and_has_ended_once_it_has_a_summary(tmp_path):
    folder = make_run(tmp_path / "one")
    life = lives.read(folder)
    assert (life.name, life.endpoint, life.ended, life.runs) == ("one", None, False, True)
    (folder / "endpoint").write_text("tcp/127.0.0.1:7447\n")
    assert lives.read(folder).endpoint == "tcp/127.0.0.1:7447"
    (folder / "summary.json").write_text(json.dumps(ENDED))
    life = lives.read(folder)
    assert life.ended and not life.runs
    assert life.farewell().startswith(f"run one ended at {lives.clock(life.seen_s)}: complete after 12 episodes; last")


def test_a_copy_of_a_run_ended_when_the_run_did(tmp_path):
    folder = make_run(tmp_path / "one", summary={**ENDED, "ended_unix_s": 1.7e9})
    life = lives.read(shutil.copytree(folder, tmp_path / "copy"))
    assert life.farewell() == (
        f"run copy ended at {lives.clock(1.7e9)}: complete after 12 episodes; last seen at {lives.clock(1.7e9)}"
    )
    assert life.fields()["last_seen"] == lives.clock(1.7e9)


def test_a_run_that_has_been_silent_does_not_run_and_its_loss_says_when_it_was_seen_and_what_to_do(tmp_path):
    folder = aged(make_run(tmp_path / "my run[/x]"), 3600)
    life = lives.read(folder)
    assert not life.runs and not life.ended
    assert lives.clock(life.seen_s) in life.loss() and "no checkpoint" in life.loss()
    (folder / "checkpoints" / "00000004").mkdir(parents=True)
    (folder / "checkpoints" / "00000004" / "manifest.json").touch()
    words = shlex.split(lives.read(folder).loss().partition("resume it with ")[2])
    assert launch.make_parser().parse_args(words[3:]).resume == folder


def test_a_run_whose_launcher_was_killed_does_not_run_however_recently_it_wrote(tmp_path):
    folder = make_run(tmp_path / "killed")
    with locks.held(folder, "run"):
        assert lives.read(aged(folder, 3600)).runs
        assert not lives.read(folder).killed
    (folder / locks.LOCK_FILE).touch()
    assert lives.read(folder).killed and not lives.read(folder).runs


def test_the_newest_run_is_the_last_started_of_those_that_run_or_else_of_all(tmp_path):
    aged(make_run(tmp_path / "killed"), 7200)
    aged(make_run(tmp_path / "ended", summary=ENDED), 3600)
    assert lives.find(tmp_path).name == "ended"
    aged(make_run(tmp_path / "running"), 30)
    make_run(tmp_path / "ended-later", summary=ENDED)
    assert lives.find(tmp_path).name == "running"
    make_run(tmp_path / "newest")
    assert lives.find(tmp_path).name == "newest"


def test_a_run_is_found_by_its_name_on_the_key_space_its_folder_or_its_path(tmp_path):
    folder = make_run(tmp_path / "a run[1]", summary=ENDED)
    make_run(tmp_path / "other")
    for name in ("a run[1]", "a-run-1-", str(folder)):
        assert lives.find(tmp_path, name).folder == folder
    with pytest.raises(RunError, match=r"'third'; allowed are .*other"):
        lives.find(tmp_path, "third")


def test_a_name_is_in_the_message_where_there_is_no_run_at_all(tmp_path):
    with pytest.raises(RunError, match="no run that is called 'nope' was found"):
        lives.find(tmp_path, "nope")


def test_where_there_is_no_run_the_folder_is_named(tmp_path):
    for missing in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(RunError, match=str(missing)):
            lives.find(missing)
    with pytest.raises(RunError, match="no run"):
        lives.read(tmp_path)


@pytest.mark.parametrize("text", ["", "{", "[]", "7", '{"ended": "comp'])
def test_a_damaged_summary_is_named(tmp_path, text):
    folder = make_run(tmp_path / "run")
    (folder / "summary.json").write_text(text)
    make_run(tmp_path / "other")
    assert lives.find(tmp_path).name == "other"
    with pytest.raises(RunError, match=r"summary\.json"):
        lives.read(folder).farewell()
