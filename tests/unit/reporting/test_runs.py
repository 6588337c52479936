import json
from dataclasses import replace

import pytest
from made_runs import RESULT, WEIGHTS_SHA256, make_run

from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.evaluation import episode_store
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.fingerprint import code_sha256
from zsdist.evaluation.records import EpisodeRecord
from zsdist.reporting import runs
from zsdist.sim.scenes import families
from zsdist.types import Outcome


def test_runs_of_one_configuration_are_the_seeds_of_a_method(tmp_path):
    folders = [make_run(tmp_path / f"r{seed}", f"seed={seed}", "run.name=full") for seed in (2, 0, 1)]
    other = make_run(tmp_path / "o", "run.name=blind")
    material = runs.read([*folders, other])
    assert [method.name for method in material.methods] == ["full", "blind"]
    assert [run.settings.seed for run in material.methods[0].runs] == [0, 1, 2]
    assert all(not method.differing for method in material.methods)


def test_runs_of_one_name_with_different_configurations_are_reported(tmp_path):
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


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("metrics.jsonl", b"{}\nnonsense\n"),
        ("metrics.jsonl", b"[1]\n"),
        ("metrics.jsonl", b"\xff\xfe\n"),
        ("episodes.jsonl", b'{"steps": 3}\n'),
        ("config.yaml", b"nothing: known\n"),
        ("summary.json", b'{"a": 1}'),
        ("summary.json", b"[]"),
    ],
)
def test_a_damaged_file_of_a_run_is_refused_with_its_place(tmp_path, file, content):
    folder = make_run(tmp_path / "a")
    (folder / file).write_bytes(content)
    with pytest.raises(RunError, match=str(folder)):
        runs.read_run(folder)


@pytest.mark.parametrize("content", ['{"runs": 5}', '{"runs": [5]}', "[[1]]"])
def test_other_json_files_beside_evaluations_are_ignored(tmp_path, content):
    (tmp_path / "other.json").write_text(content)
    (tmp_path / "one.json").write_text(json.dumps(RESULT))
    assert len(runs.read([tmp_path]).evaluations) == 1


def test_hidden_files_beside_evaluations_are_ignored(tmp_path):
    for name in ("._one.json", ".one.json.partial/two.json", "old.json/.keep.json"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"\xff\xfe")
    (tmp_path / "one.json").write_text(json.dumps(RESULT))
    assert len(runs.read([tmp_path]).evaluations) == 1


def test_a_file_beside_evaluations_that_is_no_text_is_refused_by_name(tmp_path):
    (tmp_path / "other.jsonl").write_bytes(b"\xff\xfe")
    with pytest.raises(RunError, match=r"other\.jsonl cannot be read"):
        runs.read([tmp_path])


def test_evaluations_in_a_runs_folder_are_named_after_its_method(tmp_path):
    own = RESULT | {"weights_sha256": WEIGHTS_SHA256}
    earlier = RESULT | {"policy": "checkpoints/00000050"}
    baseline = RESULT | {"policy": "random", "weights_sha256": None}
    folder = make_run(tmp_path / "a", "run.name=mine", "seed=3", summary={}, results=(own, earlier, baseline))
    evaluations = runs.read([folder]).evaluations
    assert [evaluation.label for evaluation in evaluations] == ["mine", "mine, 00000050", "random"]
    assert [evaluation.seed for evaluation in evaluations] == [3, 3, None]


def test_evaluations_that_lie_elsewhere_find_their_run_by_its_weights(tmp_path):
    folder = make_run(tmp_path / "a", "run.name=mine", summary={})
    (tmp_path / "far.json").write_text(json.dumps(RESULT | {"weights_sha256": WEIGHTS_SHA256}))
    (evaluation,) = runs.read([folder, tmp_path / "far.json"]).evaluations
    assert (evaluation.label, evaluation.method, evaluation.seed) == ("mine", "mine", 0)


def test_evaluations_are_also_read_from_files_and_folders_outside_runs(tmp_path):
    (tmp_path / "many").mkdir()
    (tmp_path / "many" / "a.json").write_text(json.dumps(RESULT | {"policy": "runs/mine"}))
    (tmp_path / "many" / "notes.json").write_text("[1, 2]")
    one = tmp_path / "one.json"
    one.write_text(json.dumps(RESULT | {"policy": "astar", "weights_sha256": None}))
    evaluations = runs.read([tmp_path / "many", one]).evaluations
    assert [evaluation.label for evaluation in evaluations] == ["mine", "astar"]


def test_a_variant_is_named_after_its_method(tmp_path):
    result = RESULT | {"policy": "hybrid", "run": "runs/mine", "variant": "hybrid", "weights_sha256": WEIGHTS_SHA256}
    folder = make_run(tmp_path / "a", "run.name=full", summary={}, results=[result])
    (evaluation,) = runs.read([folder]).evaluations
    assert (evaluation.label, evaluation.variant) == ("full, hybrid", "hybrid")


def test_figures_without_the_shield_are_an_evaluation_of_their_own(tmp_path):
    bare = {"success": 0.5, "collision": 0.5, "timeout": 0.0, "spl": 0.3, "success_95": [0.2, 0.8]}
    result = RESULT | {"weights_sha256": WEIGHTS_SHA256, "without_shield": bare}
    folder = make_run(tmp_path / "a", "run.name=mine", summary={}, results=[result])
    shielded, without = runs.read([folder]).evaluations
    assert (shielded.label, shielded.result["success"]) == ("mine", 0.9)
    assert (without.label, without.result["success"]) == ("mine, no shield", 0.5)


def test_several_runs_in_one_file_are_separate_evaluations(tmp_path):
    together = {"policies": ["a", "b"], "runs": [RESULT | {"policy": "a"}, RESULT | {"policy": "b"}]}
    (tmp_path / "both.json").write_text(json.dumps(together))
    assert [evaluation.label for evaluation in runs.read([tmp_path / "both.json"]).evaluations] == ["a", "b"]


def test_episodes_in_a_file_are_summarised_by_driver_and_scenes_without_older_code(tmp_path):
    scenes = [families.draw("iid", "test", index) for index in range(3)]
    file, contender = tmp_path / "episodes.jsonl", Contender(Config(), baseline="random")
    record = EpisodeRecord("made", Outcome.SUCCESS, 10, 8, 6.0, 5.0, 0.0, 0.4, True, (1.0,) * 10, 0, ())
    book = episode_store.EpisodeStore(file, contender, "random", None, "iid", 0, scenes)
    book.add(0, replace(record, outcome=Outcome.COLLISION))
    old = file.read_text().replace(code_sha256(), "0" * 16)
    book.add(1, record)
    book.add(0, record)
    file.write_text(old + "".join(file.read_text().splitlines(keepends=True)[1:]))
    (evaluation,) = runs.read([file]).evaluations
    assert (evaluation.label, evaluation.scenes) == ("random", "iid")
    assert (evaluation.result["episodes"], evaluation.result["success"]) == (2, 1.0)


def test_episodes_of_equivalent_code_are_summed_up_together(tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "equivalent", lambda code: {"0" * 16, code_sha256()})
    scenes = [families.draw("iid", "test", index) for index in range(2)]
    file, contender = tmp_path / "episodes.jsonl", Contender(Config(), baseline="random")
    record = EpisodeRecord("made", Outcome.SUCCESS, 10, 8, 6.0, 5.0, 0.0, 0.4, True, (1.0,) * 10, 0, ())
    book = episode_store.EpisodeStore(file, contender, "random", None, "iid", 0, scenes)
    book.add(0, replace(record, outcome=Outcome.COLLISION))
    file.write_text(file.read_text().replace(code_sha256(), "0" * 16))
    book.add(1, record)
    (evaluation,) = runs.read([file]).evaluations
    assert (evaluation.result["episodes"], evaluation.result["success"]) == (2, 0.5)


@pytest.mark.parametrize("place", ["nowhere", "empty"])
def test_a_path_with_nothing_to_report_on_is_refused_by_name(tmp_path, place):
    (tmp_path / "empty").mkdir()
    with pytest.raises(RunError, match=f"{place} holds neither a run nor an evaluation"):
        runs.read([tmp_path / place])
