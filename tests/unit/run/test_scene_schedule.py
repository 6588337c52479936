import pytest

from zsdist.config import parse
from zsdist.errors import SceneError
from zsdist.run.scene_schedule import SceneSchedule, scene_source
from zsdist.sim.scenes import scene


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


def test_a_source_that_is_neither_family_nor_folder_is_refused_with_what_is_allowed():
    with pytest.raises(SceneError, match=r"'nowhere' is no folder; allowed are .*iid.* and a folder of scene files"):
        scene_source("nowhere")


def test_the_files_of_a_folder_serve_every_split(tmp_path):
    for index in range(2):
        scene.write(scene_source("iid")("train", index), tmp_path / f"{index}.yaml")
    source = scene_source(str(tmp_path))
    assert source("train", 1).hash() == source("validation", 1).hash() == source("train", 3).hash()
    assert source("train", 0).hash() != source("train", 1).hash()
