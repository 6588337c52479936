"""The state with which a learner begins: kept by its predecessor, else the newest sound one of a checkpoint."""

import hashlib
import json
import threading

import pytest

from zsdist.config import LevelConfig, parse
from zsdist.dqn.learner import DqnLearner
from zsdist.roles.base import Context
from zsdist.run import learners
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Level
from zsdist.wire import codec
from zsdist.wire.messages import State


def begin(folder, restored=None, epoch=5):
    context = Context(parse({}), "r", "learner", "low", epoch, MemoryTransport(MemoryBroker()), threading.Event())
    dqn = DqnLearner(3, 2, LevelConfig(hidden=(4,)), seed=0)
    return learners.resumed(context, Level.LOW, dqn, restored, folder=folder, start="s")


def state_at(updates):
    state = begin_anew().state()
    return State(state.role, state.meta | {"updates": updates}, state.arrays)


def begin_anew():
    context = Context(parse({}), "r", "learner", "low", 1, MemoryTransport(MemoryBroker()), threading.Event())
    return learners.Learner(context, Level.LOW, DqnLearner(3, 2, LevelConfig(hidden=(4,)), seed=0))


def checkpoint(folder, number, updates):
    path = folder / "checkpoints" / f"{number:08d}"
    path.mkdir(parents=True)
    payload = codec.encode(state_at(updates))
    (path / "learner-low.state").write_bytes(payload)
    manifest = {"sha256": {"learner-low": hashlib.sha256(payload).hexdigest(), "replay": "0" * 64}}
    (path / "manifest.json").write_text(json.dumps(manifest))
    return path


def test_the_newest_sound_checkpoint_is_used_where_nothing_was_kept(tmp_path):
    assert begin(tmp_path).updates == 0
    for number, updates in ((10, 100), (20, 200), (30, 300)):
        checkpoint(tmp_path, number, updates)
    assert begin(tmp_path, state_at(50)).updates == 300
    assert begin(tmp_path, state_at(999)).updates == 999


@pytest.mark.parametrize("damage", ["state", "manifest", "missing"])
def test_a_damaged_checkpoint_is_passed_over(tmp_path, damage):
    checkpoint(tmp_path, 10, 100)
    newest = checkpoint(tmp_path, 20, 200)
    match damage:
        case "state":
            path = newest / "learner-low.state"
            content = bytearray(path.read_bytes())
            content[len(content) // 2] ^= 1
            path.write_bytes(content)
        case "manifest":
            (newest / "manifest.json").write_text("[")
        case "missing":
            (newest / "learner-low.state").unlink()
    assert begin(tmp_path).updates == 100


def test_without_the_run_directory_nothing_is_written(tmp_path):
    learner = begin(tmp_path / "elsewhere", state_at(7))
    learner.step(1.0)
    assert learner.updates == 7
    assert not (tmp_path / "elsewhere").exists()
