import shutil

import numpy as np
import pytest
from recordings import recorded

from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.planning.grid import Grid
from zsdist.recording import minari_export
from zsdist.recording.episode import read_episode
from zsdist.recording.minari_export import MinariSet, set_name


@pytest.fixture(scope="module")
def episodes(tmp_path_factory):
    made = recorded(tmp_path_factory.mktemp("set") / "set", 3)
    return [read_episode(path) for path in made.episodes().values()]


def new(root):
    return MinariSet(root, "zsdist/made-v0", Grid(), Config().model_dump(mode="json"), {"description": "made"})


def test_minari_reads_every_episode_after_each_one(tmp_path, episodes, monkeypatch):
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    for count, episode in enumerate(episodes, 1):
        new(tmp_path).append(episode)
        found = minari.load_dataset("zsdist/made-v0")
        assert found.total_episodes == count
        assert found.total_steps == sum(len(one.actions) for one in episodes[:count])
        for read, written in zip(found.iterate_episodes(), episodes, strict=False):
            assert np.array_equal(read.observations["image"], written.pictures)  # without loss
            assert np.array_equal(read.observations["pose"], written.poses)
            assert np.array_equal(read.actions, written.actions)
            assert read.rewards == pytest.approx(written.rewards.sum(axis=1))
            assert np.array_equal(read.terminations, written.terminated)
            assert np.array_equal(read.truncations, written.truncated)
    assert found.recover_environment().observation_space["image"].shape == (224, 224, 3)


def test_what_a_killed_export_leaves_is_no_episode_and_does_not_hinder_the_next(tmp_path, episodes):
    minari = pytest.importorskip("minari")
    exported = new(tmp_path)
    exported.append(episodes[0])
    shutil.copytree(exported.path / "0", exported.path / "1")  # moved into place and not counted
    (exported.path / "1" / "part-1.parquet").write_bytes(b"half")
    staging = exported.path.with_name(".data.partial")
    staging.mkdir()
    (staging / "metadata.json").write_text("{")
    assert minari.MinariDataset(exported.path).total_episodes == 1
    exported = new(tmp_path)
    exported.append(episodes[1])
    last = list(minari.MinariDataset(exported.path).iterate_episodes())[-1]
    assert np.array_equal(last.actions, episodes[1].actions)
    assert sorted(path.name for path in exported.path.parent.iterdir()) == ["data"]


def test_without_minari_one_line_says_what_to_install(monkeypatch):
    def missing(name):
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(minari_export, "import_module", missing)
    with pytest.raises(RunError, match=r"needs the package pyarrow.*pip install 'zsdist\[datasets\]'"):
        minari_export.require_minari()


def test_a_name_has_only_the_letters_that_minari_allows():
    assert set_name(["my run", "", "ood/layout.x"]) == "zsdist/my-run-ood-layout-x-v0"
