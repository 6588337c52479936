import json

import pytest

from zsdist import cli, evaluate
from zsdist.evaluation import report as reports
from zsdist.evaluation.baselines import BASELINES
from zsdist.evaluation.workers import Entrant, drive_all
from zsdist.sim import families, scene

KEYS = [
    "policy", "weights_sha256", "scenes", "episodes", "seed", "success", "collision", "timeout", "spl", "soft_spl",
    "path_efficiency", "min_clearance_m", "decision_ms", "confidence_95", "per_scene",
]  # fmt: skip


def run(*arguments):
    with pytest.raises(SystemExit) as exit_:
        cli.execute(evaluate.main, evaluate.make_parser(), arguments)
    return exit_.value.code


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenes")
    for index in range(3):
        scene.write(families.draw("singleton", "test", index), path / f"{index}.yaml")
    return path


def test_list_names_every_baseline_with_what_it_sees(capsys):
    assert run("--list") == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(BASELINES)
    assert all("sees" in line for line in lines)


def test_a_folder_is_driven_once_and_the_json_is_the_documented_one(folder, tmp_path, capsys):
    file = tmp_path / "result.json"
    assert run("astar", "--scenes", str(folder), "--episodes", "3", "--json", str(file), "--workers", "1") == 0
    result = json.loads(file.read_text())
    assert list(result) == KEYS
    assert (result["policy"], result["scenes"], result["episodes"]) == ("astar", str(folder), 3)
    assert result["success"] == 1.0 and result["weights_sha256"] is None
    expected = [families.draw("singleton", "test", index).name for index in range(3)]
    assert [row["scene"] for row in result["per_scene"]] == expected
    assert set(result["decision_ms"]) == {"p50", "p99"}
    assert result["confidence_95"]["success"][1] == 1.0
    table = capsys.readouterr().out
    for words in ("n 3, seed 0", "success within 0.6 m", "at most 500 actions", "SoftSPL"):
        assert words in " ".join(table.split())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "no policy was named"),
        (("nowhere",), "'nowhere' is no folder; allowed are a run directory, a checkpoint and random"),
        (("astar", "--scenes", "mars"), "scenes is 'mars'"),
        (("astar", "--episodes", "0"), "allowed is a whole number of 1 or more"),
        (("astar", "--seed", "-1"), "--seed"),
        (("astar", "--json", "/nowhere/result.json"), "allowed is a file in a folder that exists"),
        (("astar", "--config", "/nowhere/config.yaml"), "No such file"),
    ],
)
def test_what_is_wrong_is_one_line_and_status_2(arguments, words, capsys):
    assert run(*arguments) == 2
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1 and words in complaint


def test_a_folder_without_weights_is_refused(tmp_path, capsys):
    assert run(str(tmp_path)) == 2
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1 and str(tmp_path) in complaint


def test_a_baselines_world_may_be_configured(folder, tmp_path):
    (tmp_path / "short.yaml").write_text("sim: {max_steps: 2}\n")
    entrant, sha256 = evaluate.find_policy("astar", tmp_path / "short.yaml")
    assert sha256 is None
    records = drive_all(entrant, scene.read_folder(folder)[:1], seed=0, workers=1, on_record=lambda record: None)
    assert records[0].steps == 2 and records[0].outcome == "timeout"


def test_progress_without_a_terminal_is_plain_lines(folder, capsys, monkeypatch):
    monkeypatch.setattr(reports, "PLAIN_EVERY_S", -1.0)
    entrant = Entrant(evaluate.config.Config(), baseline="astar")
    reports.evaluate(entrant, policy="astar", weights_sha256=None, scenes=str(folder), episodes=2, seed=0, workers=1)
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("astar")]
    assert lines[-1] == "astar: 2 of 2: success 2, collision 0, timeout 0"
