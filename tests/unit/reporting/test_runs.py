import json

import pytest
from made_runs import RESULT, make_run

from zsdist.errors import RunError
from zsdist.reporting import runs


def test_runs_of_one_configuration_are_the_seeds_of_a_method(tmp_path):
    folders = [make_run(tmp_path / f"r{seed}", f"seed={seed}", "run.name=full") for seed in (2, 0, 1)]
    other = make_run(tmp_path / "o", "run.name=blind")
    material = runs.read([*folders, other])
    assert [method.name for method in material.methods] == ["full", "blind"]
    assert [run.settings.seed for run in material.methods[0].runs] == [0, 1, 2]
    assert all(not method.differing for method in material.methods)


def test_runs_of_one_name_that_are_not_one_configuration_are_told_apart(tmp_path):
    places = [make_run(tmp_path / "a", "agent.trail=0.8"), make_run(tmp_path / "b", "seed=1", "run.episodes=7")]
    assert runs.read(places).methods[0].differing == ["agent.trail"]


def test_the_same_folder_twice_is_one_run(tmp_path):
    folder = make_run(tmp_path / "a")
    assert len(runs.read([folder, folder / ".." / "a"]).runs) == 1


def test_episodes_are_in_the_order_in_which_they_finished(tmp_path):
    assert [row["episode"] for row in runs.read_run(make_run(tmp_path / "a")).episodes] == [1, 2, 3]


def test_a_line_that_is_still_being_written_is_left_out(tmp_path):
    folder = make_run(tmp_path / "a")
    with (folder / "episodes.jsonl").open("a") as file:
        file.write('{"episode": 4, "finish')
    assert len(runs.read_run(folder).episodes) == 3


def test_a_damaged_line_is_named(tmp_path):
    folder = make_run(tmp_path / "a")
    (folder / "metrics.jsonl").write_text("{}\nnonsense\n")
    with pytest.raises(RunError, match=r"metrics\.jsonl"):
        runs.read_run(folder)


def test_evaluations_of_a_run_bear_the_name_of_its_method(tmp_path):
    untrained = RESULT | {"policy": "untrained", "weights_sha256": "cd" * 32}
    baseline = RESULT | {"policy": "random", "weights_sha256": None}
    summary = {"merges": [], **{key: 0 for key in RESULT}}
    folder = make_run(tmp_path / "a", "run.name=full", summary=summary, results=(RESULT, untrained, baseline))
    evaluations = runs.read([folder]).evaluations
    assert [evaluation.label for evaluation in evaluations] == ["full", "full, untrained", "random"]


def test_evaluations_lie_in_files_and_folders_of_their_own_as_well(tmp_path):
    (tmp_path / "many").mkdir()
    (tmp_path / "many" / "a.json").write_text(json.dumps(RESULT | {"policy": "runs/mine"}))
    (tmp_path / "many" / "notes.json").write_text("[1, 2]")
    one = tmp_path / "one.json"
    one.write_text(json.dumps(RESULT | {"policy": "astar", "weights_sha256": None}))
    evaluations = runs.read([tmp_path / "many", one]).evaluations
    assert [evaluation.label for evaluation in evaluations] == ["mine", "astar"]


@pytest.mark.parametrize("place", ["nowhere", "empty"])
def test_a_place_with_nothing_to_report_on_is_refused_by_name(tmp_path, place):
    (tmp_path / "empty").mkdir()
    with pytest.raises(RunError, match=f"{place} holds neither a run nor an evaluation"):
        runs.read([tmp_path / place])
