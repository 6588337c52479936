import json

import pytest

from zsdist import sweep
from zsdist.common import locks
from zsdist.errors import RunError
from zsdist.sweeping import plan
from zsdist.sweeping.folder import TrialFiles

TEXT = "seeds: [0, 1]\nvariants: {one: {}, two: {agent.trail: 0}}\nevaluation: {scenes: iid, episodes: 4}\n"


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(TEXT)
    return path


def run(*words):
    return sweep.main(sweep.make_parser().parse_args(list(map(str, words))))


def evaluated(file, folder, reached):
    """Write what a trial leaves, for all trials of a file; `reached` of four scenes by variant."""
    made, trials = plan.read(file)
    for trial in trials:
        files = TrialFiles(folder, made, trial)
        files.prepare()
        files.run.mkdir()
        (files.run / "summary.json").write_text(json.dumps({"env_steps": 1000, "wall_s": 60.0}))
        wins = reached[trial.title]
        scenes = [{"scene": f"iid-{n:06d}", "outcome": "success" if n < wins else "collision"} for n in range(4)]
        result = {"scenes": "iid", "episodes": 4, "seed": 0, "success": wins / 4, "collision": 1 - wins / 4}
        result |= {"timeout": 0.0, "spl": 0.5, "confidence_95": {"success": [0, 1]}, "per_scene": scenes}
        (folder / "trials" / f"{trial.name}.json").write_text(json.dumps(result))


def test_a_sweep_whose_trials_are_done_shows_its_table_and_drives_nothing(file, tmp_path, capsys):
    folder = tmp_path / "out"
    evaluated(file, folder, {"one": 4, "two": 1})
    assert run(file, "--out", folder) == 0
    said = capsys.readouterr().out
    assert "0 of 4 trials to do" in said and "1.00 (1.00-1.00)" in said
    one, two = json.loads((folder / "summary.json").read_text())["variants"]
    assert (one["success"], two["success"]) == (1.0, 0.25) and two["success_95"][0] < 0.25 < two["success_95"][1]
    assert (one["env_steps"], one["wall_s"], one["seeds"]) == (1000, 60.0, [0, 1])
    assert "| two | 2 of 2 | 0.25" in (folder / "table.md").read_text()


def test_another_evaluation_is_made_again_and_trials_may_be_added(file, tmp_path, capsys):
    folder = tmp_path / "out"
    evaluated(file, folder, {"one": 4, "two": 1})
    file.write_text(TEXT.replace("[0, 1]", "[0, 1, 2]"))
    assert run(file, "--out", folder, "--check") == 0
    assert capsys.readouterr().out.count(", not done") == 2
    file.write_text(TEXT.replace("episodes: 4", "episodes: 5"))
    assert run(file, "--out", folder, "--check") == 0
    assert capsys.readouterr().out.count(", not done") == 4


def test_a_second_sweep_on_one_folder_is_refused(file, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    with locks.held(folder, "x"), pytest.raises(RunError, match=r"sweep folder .* is in use by process"):
        run(file, "--out", folder)


def test_a_trial_goes_on_where_it_was_broken_off(file, tmp_path):
    made, (trial, *_) = plan.read(file)
    train, evaluate = TrialFiles(tmp_path, made, trial).stages()
    assert "--auto-resume" in train and "--resume" in evaluate
