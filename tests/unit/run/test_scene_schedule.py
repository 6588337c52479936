import pytest

from zsdist.config import parse
from zsdist.errors import SceneError
from zsdist.run.scene_schedule import SceneSchedule, scene_source
from zsdist.sim.scenes import families, scene
from zsdist.sim.scenes.manifest import SPLITS, split_seed


def schedule(*families, seed=0, train_scenes=3):
    return SceneSchedule(parse({"seed": seed, "scenes": {"train": families, "train_scenes": train_scenes}}))


def test_the_scene_of_a_number_follows_from_the_seed_alone():
    one, same, other = schedule("iid"), schedule("iid"), schedule("iid", seed=1)
    numbers = range(1, 13)
    assert [one.training(n).hash() for n in numbers] == [same.training(n).hash() for n in reversed(numbers)][::-1]
    assert [one.training(n).name for n in numbers] != [other.training(n).name for n in numbers]


def test_families_take_turns_and_have_so_many_scenes():
    both = schedule("iid", "singleton")
    names = [both.training(number).name for number in range(40)]
    assert all(name.startswith("iid") for name in names[::2])
    assert all(name.startswith("singleton") for name in names[1::2])
    assert len(set(names[::2])) <= 3


def test_validation_scenes_are_new_for_each_merge_and_never_those_of_training():
    scenes = schedule("iid")
    validation = {(merge, index): scenes.validation(merge, index).hash() for merge in (1, 2) for index in range(3)}
    assert len(set(validation.values())) == 6
    assert not set(validation.values()) & {scenes.training(number).hash() for number in range(12)}


def drawn_indices(monkeypatch, merges, validation_scenes=20, **scenes):
    """Indices in the split of the validation scenes of each merge."""
    asked = []
    monkeypatch.setattr(families, "draw", lambda name, split, index: asked.append(split_seed(split, index)))
    settings = {"scenes": {"train": ["iid"]} | scenes, "merge": {"validation_scenes": validation_scenes}}
    plan = SceneSchedule(parse(settings))
    for merge in merges:
        for index in range(validation_scenes):
            plan.validation(merge, index)
    return [seed - SPLITS["validation"].start for seed in asked]


@pytest.mark.parametrize("validation_scenes", [1, 7, 20, 10_000])
def test_the_first_hundred_merges_keep_their_validation_scenes(monkeypatch, validation_scenes):
    merges = (0, 1, 2, 50, 99)
    expected = [merge * 10_000 + index for merge in merges for index in range(validation_scenes)]
    assert drawn_indices(monkeypatch, merges, validation_scenes) == expected


def test_every_merge_has_new_scenes_until_the_split_is_used_up(monkeypatch):
    indices = drawn_indices(monkeypatch, range(2000))
    assert len(set(indices)) == 2000 * 20


@pytest.mark.parametrize("merge", [100, 49_999, 50_000, 10**6, 2**31, 10**12])
@pytest.mark.parametrize("validation_scenes", [1, 20, 33, 10_000])
def test_any_number_of_merges_has_scenes(monkeypatch, merge, validation_scenes):
    indices = drawn_indices(monkeypatch, [merge], validation_scenes)
    assert len(set(indices)) == validation_scenes


def test_scenes_of_late_merges_are_solvable_scenes_of_the_validation_split():
    assert schedule("iid").validation(100, 3).name == f"iid-{1_000_000 + 20 + 3}"


def test_the_ten_scenes_and_those_of_a_folder_stay_as_they_are_in_late_merges(tmp_path):
    for index in range(7):
        scene.write(scene_source("iid")("train", index), tmp_path / f"{index}.yaml")
    both = schedule("singleton", str(tmp_path))
    for merge in (99, 100, 12_345):
        number = merge * 10_000
        assert both.validation(merge, 4).name == f"singleton-{(number + 4) % 10:06d}"
        assert both.validation(merge, 5).hash() == scene_source(str(tmp_path))("train", (number + 5) % 7).hash()


def test_a_source_that_is_neither_family_nor_folder_is_refused_with_what_is_allowed():
    with pytest.raises(SceneError, match=r"'nowhere' is no folder; allowed are .*iid.* and a folder of scene files"):
        scene_source("nowhere")


def test_the_files_of_a_folder_serve_every_split(tmp_path):
    for index in range(2):
        scene.write(scene_source("iid")("train", index), tmp_path / f"{index}.yaml")
    source = scene_source(str(tmp_path))
    assert source("train", 1).hash() == source("validation", 1).hash() == source("train", 3).hash()
    assert source("train", 0).hash() != source("train", 1).hash()
