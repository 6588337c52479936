"""Damage of checkpoints: every flipped bit and every missing file is found, named, and the one before is used."""

import json
import random
import shutil

import numpy as np
import pytest

from zsdist import config
from zsdist.errors import DamagedError, RunError, WeightsError
from zsdist.run import checkpoint_files, directory
from zsdist.run.checkpoint import load_policy
from zsdist.run.directory import RunDirectory
from zsdist.types import Level
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire.messages import State

VISION = VisionIdentity("clip/b", "a" * 64, "head", "b" * 64)
FILES = ["learner-high.state", "learner-low.state", "manifest.json", "replay.state", "scheduler.state"]


@pytest.fixture
def folder(tmp_path):
    made = directory.create(tmp_path / "run", config.Config())
    with_checkpoints = RunDirectory(made, VISION)
    for count in (1, 2, 3):
        weights = {"dqn/online/weight": np.full(2, count, np.float32)}
        learners = {f"learner-{level}": State(f"learner-{level}", {}, weights) for level in Level}
        scheduler = State("scheduler", {"finished": list(range(count))}, {})
        with_checkpoints.checkpoint(
            count, learners | {"scheduler": scheduler, "replay": State("replay", {}, {"ring": np.ones(count)})}
        )
    return made


def newest(folder):
    return folder / "checkpoints" / "00000003"


def flip(path, bit):
    content = bytearray(path.read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)


def test_any_flipped_bit_of_any_file_is_found_and_named(folder):
    rng = random.Random(23)
    for _ in range(60):
        path = newest(folder) / rng.choice(FILES)
        bit = rng.randrange(8 * path.stat().st_size)
        flip(path, bit)
        with pytest.raises(DamagedError, match=f"checkpoint file {newest(folder)}/.* is damaged"):
            checkpoint_files.read_checkpoint(path.parent)
        lines = []
        used, states, damaged = checkpoint_files.newest_whole(folder, lines.append)
        assert (used.name, damaged, len(states["replay"].arrays["ring"])) == ("00000002", [newest(folder)], 2)
        assert len(lines) == 1 and "\n" not in lines[0]
        flip(path, bit)
    assert checkpoint_files.newest_whole(folder)[0] == newest(folder)


@pytest.mark.parametrize("file", FILES)
def test_a_missing_file_is_named_and_the_checkpoint_before_is_used(folder, file):
    (newest(folder) / file).unlink()
    lines = []
    assert checkpoint_files.newest_whole(folder, lines.append)[0].name == "00000002"
    assert lines == [f"checkpoint file {newest(folder) / file} is missing; the one before it is used, 00000002"]


def test_a_manifest_of_an_earlier_version_is_read_without_a_checksum(folder):
    path = newest(folder) / "manifest.json"
    manifest = json.loads(path.read_text())
    for later in ("manifest_sha256", "rows"):
        del manifest[later]
    path.write_text(json.dumps(manifest, indent=1))
    assert checkpoint_files.newest_whole(folder)[0] == newest(folder)
    assert checkpoint_files.read_vision(newest(folder)) == VISION


def test_a_policy_comes_from_the_newest_whole_checkpoint_with_one_line_and_nothing_is_written(folder):
    (newest(folder) / "learner-low.state").write_bytes(b"")
    before, lines = sorted(folder.rglob("*")), []
    assert load_policy(folder, (), lines.append).source.endswith("00000002")
    assert [line for line in lines if line.endswith("the one before it is used, 00000002")] == lines
    assert len(lines) == 1 and sorted(folder.rglob("*")) == before
    with pytest.raises(WeightsError, match=r"learner-low\.state is damaged"):
        load_policy(newest(folder))


def test_a_run_of_which_all_checkpoints_are_damaged_is_refused_in_one_line(folder):
    for path in checkpoint_files.checkpoints(folder):
        (path / "manifest.json").unlink()
    for attempt in (directory.reopen, load_policy):
        with pytest.raises((RunError, WeightsError), match=r"is whole, of 3; the newest: .* copy one back") as caught:
            attempt(folder)
        assert "\n" not in str(caught.value)
    assert checkpoint_files.has_checkpoint(folder), "or it would begin anew"


def test_a_checkpoint_that_may_not_be_read_is_not_taken_for_damaged(folder):
    path = newest(folder) / "replay.state"
    path.unlink()
    path.mkdir()
    with pytest.raises(RunError, match=r"replay\.state cannot be read: Is a directory"):
        directory.reopen(folder)
    assert newest(folder).is_dir()


def test_a_damaged_checkpoint_that_was_set_aside_before_is_replaced(folder):
    for _ in range(2):
        (newest(folder) / "replay.state").unlink()
        directory.reopen(folder)
        shutil.copytree(folder / "checkpoints" / "00000002", newest(folder))
    assert sorted(path.name for path in (folder / "checkpoints").iterdir())[-1] == "00000003.damaged"
