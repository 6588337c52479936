import json
import shlex
import time

import numpy as np
import pytest
from fakes import FakeVisualAct, LatticeEnv

from zsdist import evaluate
from zsdist.common import cli, progress
from zsdist.config import Config
from zsdist.evaluation import report as reports
from zsdist.evaluation.baselines import BASELINES
from zsdist.evaluation.contenders import VARIANTS, Contender
from zsdist.evaluation.episodes import EpisodeRunner
from zsdist.evaluation.policies import NamedPolicy
from zsdist.evaluation.workers import drive_all
from zsdist.sim.scenes import families, scene

KEYS = [
    "policy", "weights_sha256", "scenes", "episodes", "seed", "success", "collision", "timeout", "spl", "soft_spl",
    "path_efficiency", "step_efficiency", "min_clearance_m", "shield_changed_share", "decision_ms", "confidence_95",
    "per_scene", "distinct_scenes", "run", "variant", "shielded", "success_radius_m", "max_steps", "code_sha256",
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


def test_list_names_every_baseline_with_its_observability_and_every_variant(capsys):
    assert run("--list") == 0
    baselines, variants = capsys.readouterr().out.split("variants of a learned policy, --variant NAME:\n")
    assert [line.split()[0] for line in baselines.splitlines()] == ["pretrained", *BASELINES]
    assert all("observes" in line for line in baselines.splitlines())
    assert [line.split()[0] for line in variants.splitlines()] == list(VARIANTS)


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
        (("nowhere",), "'nowhere' is no folder; allowed are a run directory, a checkpoint and pretrained"),
        (("astar", "--scenes", "mars"), "--scenes 'mars' is no folder; allowed are train, validation, test"),
        (("astar", "--video", __file__), "is a file; allowed is a folder"),
        (("astar", "--episodes", "0"), "allowed is a whole number of 1 or more"),
        (("astar", "--seed", "-1"), "--seed"),
        (("astar", "--json", "/nowhere/result.json"), "allowed is a file in a folder that exists"),
        (("astar", "--config", "/nowhere/config.yaml"), "No such file"),
        (("astar", "--variant", "hybrid"), "baseline 'astar' has no variants"),
        (("astar", "--variant", "better"), "--variant is 'better'; allowed are full, hybrid"),
        (("astar", "--no-shield"), "baseline 'astar' has no shield"),
        (("pretrained", "astar", "--no-shield"), "baseline 'astar' has no shield"),
        (("pretrained", "astar"), "baseline 'astar' is allowed alone"),
        (
            ("pretrained", "pretrained"),
            "pretrained has the weights of pretrained; allowed are policies of different training seeds",
        ),
        (("astar", "--resume"), "add --out FILE.jsonl"),
        (("astar", "--out", "/nowhere/e.jsonl"), "allowed is a file in a folder that exists"),
        (("--compare", "/nowhere/a.jsonl", "/nowhere/b.jsonl"), "episodes cannot be read from /nowhere/a.jsonl"),
    ],
)
def test_what_is_wrong_is_one_line_and_status_2(arguments, words, capsys):
    assert run(*arguments) == 2
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1 and words in complaint


def test_a_result_that_cannot_be_written_is_reported_in_one_line(folder, capsys):
    assert run("astar", "--scenes", str(folder), "--episodes", "1", "--workers", "1", "--json", "/sys/result.json") == 2
    complaint = capsys.readouterr().err.splitlines()[-1]
    assert "/sys/result.json" in complaint and "cannot be written" in complaint


def test_a_folder_without_weights_is_refused(tmp_path, capsys):
    assert run(str(tmp_path)) == 2
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1 and str(tmp_path) in complaint


def test_the_shipped_policy_was_trained_for_the_networks_and_the_vision_of_this_package():
    policy = evaluate.find_policy("pretrained")
    contender = policy.contender
    assert contender.config.scenes.train == ("iid",) and len(policy.weights_sha256) == 64
    env = LatticeEnv(config=contender.settings)
    driver = contender.driver(FakeVisualAct())
    record = EpisodeRunner(env, contender.settings, driver, contender.observability, time.monotonic).drive(
        families.draw("iid", "validation", 0), np.random.default_rng(0)
    )
    assert record.outcome == "success"


def test_a_baselines_world_may_be_configured(tmp_path):
    (tmp_path / "short.yaml").write_text("sim: {max_steps: 2}\n")
    policy = evaluate.find_policy("astar", tmp_path / "short.yaml")
    assert policy.weights_sha256 is None
    records = drive_all(
        policy.contender,
        [families.draw("singleton", "test", 0)],
        seed=0,
        workers=1,
        on_record=lambda index, record: None,
    )
    assert records[0].steps == 2 and records[0].outcome == "timeout"


def test_a_note_on_the_vision_model_is_printed_once_beside_the_result(folder, capsys, monkeypatch):
    policy = NamedPolicy("astar", Contender(Config(), baseline="astar"), note="trained with another head")
    monkeypatch.setattr(evaluate, "find_policy", lambda *_: policy)
    assert run("astar", "--scenes", str(folder), "--episodes", "1", "--workers", "1") == 0
    assert capsys.readouterr().err.splitlines().count("trained with another head") == 1


def test_progress_without_a_terminal_is_plain_lines(folder, capsys, monkeypatch):
    monkeypatch.setattr(progress, "PLAIN_EVERY_S", -1.0)
    contender = Contender(Config(), baseline="astar")
    reports.evaluate(contender, policy="astar", weights_sha256=None, scenes=str(folder), episodes=2, seed=0, workers=1)
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("astar")]
    assert lines[-1] == "astar: 2 of 2: success 2, collision 0, timeout 0"


def test_evaluations_in_the_same_processes_say_what_each_says_alone(folder, capsys, monkeypatch):
    monkeypatch.setattr(progress, "PLAIN_EVERY_S", -1.0)
    short = Config(sim={"max_steps": 9})
    contenders = {name: Contender(short, baseline=name) for name in ("random", "astar")}
    trials = [
        reports.Trial(name, contender, None, str(folder), 2, lasts=name == "astar")
        for name, contender in contenders.items()
    ]
    together = reports.evaluate_all(trials, seed=3, workers=1)
    assert "evaluation: 4 of 4: " in capsys.readouterr().err
    for trial, report in zip(trials, together, strict=True):
        about = {"policy": trial.name, "weights_sha256": None, "scenes": str(folder), "episodes": 2}
        alone = reports.evaluate(trial.contender, **about, seed=3, workers=1)
        assert [record.poses for record in report.records] == [record.poses for record in alone.records]
        times = ("decision_ms",)  # of a real clock
        found, expected = ({k: v for k, v in one.result.items() if k not in times} for one in (report, alone))
        assert found == expected and report.scenes == alone.scenes


def test_a_file_of_episodes_is_resumed_only_when_asked(folder, tmp_path, capsys):
    out, one, two = tmp_path / "episodes.jsonl", tmp_path / "one.json", tmp_path / "two.json"
    asked = ("random", "--scenes", str(folder), "--workers", "1", "--out", str(out))
    assert run(*asked, "--episodes", "2") == 0
    assert run(*asked, "--episodes", "3") == 2
    assert "allowed are a new file, and --resume" in capsys.readouterr().err
    assert run(*asked, "--episodes", "3", "--resume", "--json", str(one)) == 0
    assert "2 of 3 episodes are there already" in capsys.readouterr().err
    assert len(out.read_text().splitlines()) == 3
    assert run(*asked, "--episodes", "3", "--resume", "--json", str(two)) == 0
    assert one.read_text() == two.read_text() and len(out.read_text().splitlines()) == 3


def test_several_policies_are_taken_together(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(evaluate, "check_together", lambda policies, no_shield: None)  # baselines, which drive quickly
    file = tmp_path / "result.json"
    asked = ("--scenes", str(folder), "--episodes", "2", "--workers", "1", "--json", str(file))
    assert run("astar", "goal-greedy", *asked) == 0
    result = json.loads(file.read_text())
    successes = [of_one["success"] for of_one in result["runs"]]
    assert result["policies"] == ["astar", "goal-greedy"]
    assert result["interquartile_mean"]["success"] == pytest.approx(sum(successes) / 2)
    low, high = result["confidence_95"]["success"]
    assert low <= result["interquartile_mean"]["success"] <= high
    assert "2 runs on" in capsys.readouterr().out


def test_scenes_that_are_driven_again_count_once_for_several_policies_too(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(evaluate, "check_together", lambda policies, no_shield: None)
    results = []
    for episodes in ("3", "9"):  # the folder has three scenes
        file = tmp_path / f"{episodes}.json"
        asked = ("--scenes", str(folder), "--episodes", episodes, "--workers", "1", "--json", str(file))
        assert run("astar", "goal-greedy", *asked) == 0
        results.append(json.loads(file.read_text()))
    once, thrice = results
    assert thrice["confidence_95"] == once["confidence_95"]
    assert thrice["interquartile_mean"] == once["interquartile_mean"]


def test_two_files_of_episodes_are_compared_scene_by_scene(folder, tmp_path, capsys):
    files = {name: tmp_path / f"{name}.jsonl" for name in ("astar", "goal-greedy")}
    for name, file in files.items():
        assert run(name, "--scenes", str(folder), "--workers", "1", "--out", str(file)) == 0
    file = tmp_path / "comparison.json"
    assert run("--compare", *map(str, files.values()), "--json", str(file)) == 0
    figures = json.loads(file.read_text())["figures"]
    assert figures["success"]["pairs"] == 3 and figures["success"]["a"] == 1.0
    assert figures["spl"]["difference"] == pytest.approx(figures["spl"]["a"] - figures["spl"]["b"])
    assert "difference" in capsys.readouterr().out


def test_films_are_of_the_first_episodes_and_say_how_they_ended(folder, tmp_path, capsys):
    (tmp_path / "short.yaml").write_text("sim: {max_steps: 2}\ncamera: {size_px: 64}\n")
    options = ("--scenes", str(folder), "--config", str(tmp_path / "short.yaml"), "--workers", "1")
    assert run("astar", *options, "--video", str(tmp_path / "films"), "--video-episodes", "2") == 0
    films = sorted((tmp_path / "films").glob("*.mp4"))
    assert [film.stem.rpartition("-")[2] for film in films] == ["timeout"] * 2
    printed = capsys.readouterr().out
    assert all(f"film: {film}" in printed for film in films)


def test_ctrl_c_prints_the_command_that_resumes_with_all_that_was_given(tmp_path, monkeypatch, capsys):
    def interrupted(contender, *, out, **others):
        out.write_text("")
        raise KeyboardInterrupt

    monkeypatch.setattr(evaluate, "evaluate", interrupted)
    monkeypatch.chdir(tmp_path)
    given = ["random", "--scenes", "my scenes", "--episodes", "7", "--seed", "3", "--out", "it's.jsonl", "--workers=1"]
    given += [
        "--set",
        "vision.weights=my weights",
        "--set",
        "scenes.train=[iid, 'her scenes']",
        "--set",
        "sim.max_steps=9",
    ]
    with pytest.raises(KeyboardInterrupt):
        evaluate.main(evaluate.make_parser().parse_args(given))
    words = shlex.split(capsys.readouterr().out.splitlines()[-1])
    again = vars(evaluate.make_parser().parse_args(words[3:]))
    wanted = vars(evaluate.make_parser().parse_args(given))
    places = (f'vision.weights="{tmp_path}/my weights"', f'scenes.train=["iid", "{tmp_path}/her scenes"]')
    wanted |= {"resume": True, "out": tmp_path / "it's.jsonl", "scenes": str(tmp_path / "my scenes")}
    assert again == wanted | {"set": [*places, "sim.max_steps=9"]}
