import os
from pathlib import Path

import pytest
from made_runs import make_run

from zsdist.errors import RunError
from zsdist.run import life as lives
from zsdist.web.source import RunsSource


def refuse(life):
    raise RunError("nothing is connected here")


def source(folder, run=None):
    return RunsSource(refuse, folder, run)


def test_the_runs_of_a_folder_are_listed_with_their_state(tmp_path):
    make_run(tmp_path / "old", summary={})
    for file in make_run(tmp_path / "gone").iterdir():
        os.utime(file, (1000.0, 1000.0))
    found = source(tmp_path).runs()
    assert {run["name"]: run["state"] for run in found["runs"]} == {"old": "ended", "gone": "lost"}
    assert found["first"] == lives.find(tmp_path).title and found["told"] == ""
    assert source(tmp_path, "old").runs()["first"] == "old"


def test_a_folder_without_runs_says_so(tmp_path):
    found = source(tmp_path / "none").runs()
    assert found["runs"] == [] and "no run was found" in found["told"]


def test_curves_and_differences_of_the_named_runs(tmp_path):
    make_run(tmp_path / "a", "agent.epsilon_min=0.07")
    make_run(tmp_path / "b")
    compared = source(tmp_path).compare(["b", "a", "none"])
    assert [run["name"] for run in compared["runs"]] == ["b", "a"]
    assert compared["runs"][0]["curves"]["episodes"] == [1]
    assert compared["differences"]["agent.epsilon_min"][1] == "0.07"


def test_the_snapshot_of_a_run_that_has_ended_is_that_of_the_monitor(tmp_path):
    folder = make_run(tmp_path / "a", summary={})
    assert source(tmp_path).snapshot("") == source(tmp_path).snapshot("a") == lives.read(folder).fields()


@pytest.mark.parametrize("name", ["none", "../a", "/etc", "a/../a"])
def test_no_name_leads_out_of_the_folder(tmp_path, name):
    make_run(tmp_path / "a")
    for asked in (lambda: source(tmp_path).live(name, ""), lambda: source(tmp_path).snapshot(name)):
        with pytest.raises(RunError, match="no run in"):
            asked()


def test_the_folder_of_one_run_shows_that_run(tmp_path):
    make_run(tmp_path / "a")
    make_run(tmp_path / "b")
    assert [run["name"] for run in source(Path(tmp_path / "a")).runs()["runs"]] == ["a"]
