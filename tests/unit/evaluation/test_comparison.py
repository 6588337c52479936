import dataclasses
import sys

import pytest
from fakes import RECORD

from zsdist.config import Config
from zsdist.dqn import network
from zsdist.errors import RunError
from zsdist.evaluation import comparison, episode_store
from zsdist.evaluation.comparison import compare
from zsdist.evaluation.contenders import Contender
from zsdist.roles.shapes import SHAPES
from zsdist.sim.scenes import families
from zsdist.types import Outcome

SCENES = [families.draw("iid", "test", index) for index in range(6)]
FAILED = dataclasses.replace(RECORD, outcome=Outcome.COLLISION)


def write(file, records, baseline="astar", seed=0):
    return put(file, records, Contender(Config(), baseline=baseline), baseline, None, seed)


def write_learned(file, records, policy, weights=0, **kind):
    """Return lines of episodes of a learned policy whose networks have the hash `weights`."""
    networks = {
        level: network.initial_parameters(shape.state_size, shape.actions, (8,), weights)
        for level, shape in SHAPES.items()
    }
    return put(file, records, Contender(Config(), networks, **kind), policy, f"{weights:064d}", 0)


def put(file, records, contender, policy, weights_sha256, seed):
    store = episode_store.EpisodeStore(file, contender, policy, weights_sha256, "iid", seed, SCENES)
    for index, record in enumerate(records):
        store.add(index, record)
    return file


def test_differences_are_of_the_same_scenes(tmp_path):
    a = write(tmp_path / "a", [RECORD] * 4 + [FAILED] * 2)
    b = write(tmp_path / "b", [RECORD] * 2 + [FAILED] * 2, "random")
    compared = compare(a, b)
    success = compared.result["figures"]["success"]
    assert (success["pairs"], success["a"], success["b"], success["difference"]) == (4, 1.0, 0.5, 0.5)
    assert success["confidence_95"][0] >= 0 and success["confidence_95"][1] <= 1
    assert compared.result["figures"]["spl"]["difference"] == pytest.approx(0.5 * 0.75)
    assert compared.notes == [f"{a}: 2 episodes have no partner and are left out"]


def test_pairing_removes_the_variance_of_scenes_from_the_interval(tmp_path):
    a = write(tmp_path / "a", [RECORD, FAILED] * 3)
    b = write(tmp_path / "b", [RECORD, FAILED] * 3, "random")
    assert compare(a, b).result["figures"]["success"]["confidence_95"] == [0.0, 0.0]


def test_a_scene_counts_with_the_mean_of_a_files_training_seeds(tmp_path):
    a = write_learned(tmp_path / "a", [RECORD] * 6, "runs/1", weights=1)
    write_learned(a, [FAILED] * 6, "runs/2", weights=2)
    b = write(tmp_path / "b", [FAILED] * 6, "random")
    compared = compare(a, b)
    assert (compared.result["figures"]["success"]["a"], compared.notes) == (0.5, [])


def test_episodes_of_older_weights_do_not_count_and_are_noted(tmp_path):
    a = write_learned(tmp_path / "a", [FAILED] * 6, "runs/1", weights=1)
    write_learned(a, [RECORD] * 4, "runs/1", weights=2)
    compared = compare(a, write(tmp_path / "b", [RECORD] * 6, "random"))
    assert (compared.result["figures"]["success"]["a"], compared.result["episodes"]) == (1.0, 4)
    assert f"{a}: 6 lines of older weights or settings are left out" in compared.notes


def test_drives_without_the_shield_count_only_where_there_are_no_others(tmp_path):
    bare = write_learned(tmp_path / "bare", [FAILED] * 6, "runs/1", shielded=False)
    both = write_learned(tmp_path / "both", [RECORD] * 6, "runs/1")
    write_learned(both, [FAILED] * 6, "runs/1", shielded=False)
    compared = compare(both, bare)
    success = compared.result["figures"]["success"]
    assert (success["a"], success["b"]) == (1.0, 0.0)
    assert compared.notes == [f"{both}: 6 lines without the shield are left out"]


def test_a_file_of_different_methods_is_refused(tmp_path):
    variants = write_learned(tmp_path / "a", [RECORD] * 6, "runs/1")
    write_learned(variants, [RECORD] * 6, "runs/1", variant="hybrid")
    baselines = write(tmp_path / "b", [RECORD] * 6)
    write(baselines, [RECORD] * 6, "random")
    for file, names in ((variants, "the variant full, the variant hybrid"), (baselines, "astar, random")):
        with pytest.raises(RunError, match=f"holds episodes of {names}; allowed is one of them"):
            compare(file, write(tmp_path / "c", [RECORD] * 6))


def test_scenes_in_which_something_moves_have_no_spl(tmp_path):
    moving = [dataclasses.replace(RECORD, static=False)] * 6
    result = compare(write(tmp_path / "a", moving), write(tmp_path / "b", moving, "random")).result
    assert set(result["figures"]) == {"success", "collision"}


def test_lines_of_older_code_are_left_out_and_noted(tmp_path, monkeypatch):
    a = write(tmp_path / "a", [FAILED] * 6)
    monkeypatch.setattr(episode_store, "code_sha256", lambda: "newer")
    write(a, [RECORD] * 3)
    compared = compare(a, write(tmp_path / "b", [RECORD] * 6, "random"))
    assert compared.result["figures"]["success"]["a"] == 1.0 and compared.result["episodes"] == 3
    assert any("6 lines of other code than newer" in note for note in compared.notes)


def test_lines_of_equivalent_code_count(tmp_path, monkeypatch):
    monkeypatch.setattr(comparison, "equivalent", lambda code: {"older", "newer"} if code == "newer" else {code})
    monkeypatch.setattr(episode_store, "code_sha256", lambda: "older")
    a, b = write(tmp_path / "a", [RECORD] * 6), write(tmp_path / "b", [FAILED] * 6, "random")
    monkeypatch.setattr(episode_store, "code_sha256", lambda: "newer")
    write(a, [FAILED] * 3)
    compared = compare(a, b)
    assert (compared.result["figures"]["success"]["a"], compared.result["episodes"]) == (0.5, 6)
    assert compared.notes == []


def test_files_without_a_common_scene_are_refused(tmp_path):
    a, b = write(tmp_path / "a", [RECORD] * 2), write(tmp_path / "b", [RECORD] * 2, "random", seed=1)
    with pytest.raises(RunError, match="no scene, seed and index in common"):
        compare(a, b)


def test_an_empty_file_is_refused(tmp_path):
    (tmp_path / "empty").touch()
    with pytest.raises(RunError, match="holds no episode"):
        compare(tmp_path / "empty", write(tmp_path / "b", [RECORD]))


def test_pairs_that_repeat_a_scene_count_once_and_are_noted(tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "SCENES", SCENES[:3] * 2)
    a = write(tmp_path / "a", [RECORD, FAILED, RECORD] * 2)
    b = write(tmp_path / "b", [FAILED] * 6, "random")
    compared = compare(a, b)
    assert compared.result["figures"]["success"]["pairs"] == 3 == compared.result["episodes"]
    assert "3 pairs repeat a scene and are left out" in compared.notes
