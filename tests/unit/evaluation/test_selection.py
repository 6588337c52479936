import shutil

import pytest

from zsdist.config import Config, load
from zsdist.errors import SceneError
from zsdist.evaluation.selection import select
from zsdist.sim.scenes import families, scene

CONFIG = Config()


def hashes(*arguments):
    return [chosen.hash() for chosen in select(*arguments)]


@pytest.fixture
def folder(tmp_path):
    for index in range(3):
        scene.write(families.draw("iid", "test", index), tmp_path / f"{index}.yaml")
    return tmp_path


def test_a_folder_is_driven_once_in_the_order_of_its_files(folder):
    expected = [families.draw("iid", "test", index).hash() for index in range(3)]
    assert hashes(str(folder), CONFIG, None, 7) == expected == hashes(str(folder), CONFIG, 3, 0)


def test_more_episodes_than_files_repeat_the_folder(folder):
    once = hashes(str(folder), CONFIG, None, 0)
    assert hashes(str(folder), CONFIG, 5, 0) == once + once[:2]


def test_a_family_gives_its_test_scenes_and_another_seed_others():
    first = hashes("iid", CONFIG, 3, 0)
    assert first == [families.draw("iid", "test", index).hash() for index in range(3)]
    assert first == hashes("iid", CONFIG, 5, 0)[:3]
    assert not set(first) & set(hashes("iid", CONFIG, 3, 1))


def test_splits_take_the_configured_families_in_turn():
    names = [chosen.name for chosen in select("test", CONFIG, 6, 0)]
    assert [name.rsplit("-", 1)[0] for name in names] == [*CONFIG.scenes.test] * 2
    assert len(set(names)) == 6


def test_train_and_validation_scenes_are_of_the_training_families_and_never_the_same():
    scattered = load(overrides=("scenes.train=[iid]",))
    train, validation = (hashes(name, scattered, 4, 0) for name in ("train", "validation"))
    assert len(set(train + validation)) == 8
    assert train == [families.draw("iid", "train", index).hash() for index in range(4)]


@pytest.mark.parametrize("train_scenes", [1000, 60, 3])
def test_training_scenes_are_those_that_training_draws_from_whatever_the_seed(train_scenes):
    config = load(overrides=("scenes.train=[iid]", f"scenes.train_scenes={train_scenes}"))
    drawn = {f"iid-{index:06d}" for index in range(train_scenes)}
    for seed in (0, 1, 2, 999):
        assert {chosen.name for chosen in select("train", config, 5, seed)} <= drawn
    if train_scenes == 1000:
        assert not set(hashes("train", config, 5, 0)) & set(hashes("train", config, 5, 1))


def test_a_configured_folder_serves_as_a_training_family(folder):
    config = load(overrides=(f"scenes.train=[{folder}, iid]",))
    chosen = hashes("train", config, 4, 0)
    assert chosen[0::2] == hashes(str(folder), config, 2, 0)
    assert chosen[1::2] == [families.draw("iid", "train", index).hash() for index in range(2)]


def test_a_folder_in_the_working_directory_does_not_replace_a_family_or_a_split(folder, monkeypatch):
    before = [hashes(name, CONFIG, 3, 7) for name in ("iid", "test")]
    for name in ("iid", "test"):
        shutil.copytree(folder, folder / "elsewhere" / name, ignore=shutil.ignore_patterns("elsewhere"))
    monkeypatch.chdir(folder / "elsewhere")
    assert [hashes(name, CONFIG, 3, 7) for name in ("iid", "test")] == before
    assert hashes("./iid", CONFIG, None, 7) == hashes(str(folder), CONFIG, None, 7)


def test_a_configured_folder_may_have_the_name_of_a_split(folder, tmp_path, monkeypatch):
    shutil.copytree(folder, tmp_path / "elsewhere" / "test", ignore=shutil.ignore_patterns("elsewhere"))
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert hashes("train", load(overrides=("scenes.train=[test]",)), 3, 0) == hashes(str(folder), CONFIG, None, 0)


def test_singleton_has_ten_scenes():
    assert len(set(hashes("singleton", CONFIG, 12, 0))) == 10


def test_default_is_fifty_scenes_of_a_family():
    assert len(select("singleton", CONFIG, None, 0)) == 50


def test_an_unknown_name_is_refused_with_what_is_allowed():
    with pytest.raises(SceneError, match=r"'mars'.*validation.*ood-layout.*folder"):
        select("mars", CONFIG, 1, 0)
