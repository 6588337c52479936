import json

import numpy as np
import pytest

from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.pretraining.job import Job
from zsdist.pretraining.pictures import LIST_FILE, Pictures, save
from zsdist.vision.rays import RAYS

JOB = Job(64, 0, 0, ("street",), "", ("words", "head"), Config(), "")


def views(scenes, **more):
    """Return a picture of each scene, with the scene's number as tokens."""
    count = len(scenes)
    return {
        "tokens": np.array(scenes, np.float16).reshape(-1, 1, 1, 1).repeat(2, -1),
        "ray_distance_m": np.ones((count, RAYS), np.float32),
        "ray_dynamic": np.zeros((count, RAYS), bool),
        "scene": np.array(scenes, np.uint64),
        **more,
    }


def masked(scenes, original, background):
    return views(scenes, original=np.array(original), background=np.array(background))


def pictures(folder, **shards):
    for name, arrays in shards.items():
        save(folder / name.replace("_", "-"), arrays)
    (folder / LIST_FILE).write_text(json.dumps([name.replace("_", "-") for name in shards]))
    return Pictures(JOB, folder)


def numbers(examples):
    return np.asarray(examples.tokens)[:, 0, 0, 0].tolist()


def test_scenes_of_whole_and_masked_pictures_are_kept_out_of_the_validation(tmp_path):
    hidden = masked([5, 5], [-1, 0], [False, True])
    made = pictures(tmp_path, act_0000=views([1, 2]), validation_0000=views([2, 3, 5, 6]), masked_0000=hidden)
    assert numbers(made.examples()) == [1, 2] and numbers(made.validation()) == [3, 6]


def test_masked_pictures_without_scene_numbers_are_read_and_keep_nothing_out(tmp_path):
    hidden = masked([5, 5], [-1, 0], [False, True])
    del hidden["scene"]
    made = pictures(tmp_path, act_0000=views([1]), validation_0000=views([1, 5]), masked_0000=hidden)
    assert numbers(made.validation()) == [5] and len(made.masked()[1]) == 1


def test_a_shard_with_nothing_but_hidden_files_is_empty(tmp_path):
    made = pictures(tmp_path, act_0000=views([1]), act_0001={}, validation_0000=views([5]))
    for name in ("act-0000", "act-0001"):
        (tmp_path / name / ".DS_Store").write_bytes(b"\x00")
        (tmp_path / name / "._tokens.npy").write_bytes(b"\x00")
    assert numbers(made.examples()) == [1]


def test_a_validation_of_trained_scenes_only_is_refused(tmp_path):
    made = pictures(tmp_path, act_0000=views([1, 2]), validation_0000=views([2, 1]))
    with pytest.raises(RunError, match="no picture of 'validation' is of a scene that is not trained on"):
        made.validation()


def test_masked_pictures_find_their_originals_in_any_shard(tmp_path):
    first = masked([1, 1, 2], [-1, 0, -1], [False, True, False])
    second = masked([3, 3, 3], [-1, 0, 0], [False, False, True])
    originals, parts = pictures(tmp_path, masked_0000=first, masked_0001=second).masked()
    assert numbers(originals) == [1, 2, 3]
    assert parts.image.tolist() == [0, 2, 2] and parts.background.tolist() == [True, False, True]
    assert numbers(parts) == [1, 3, 3]
