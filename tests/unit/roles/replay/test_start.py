import threading

import pytest
from recordings import recorded
from rehearsal import rehearse, resume, start

from zsdist import config
from zsdist.errors import RunError
from zsdist.roles.base import Context
from zsdist.roles.replay.role import Replay
from zsdist.roles.replay.start import recorded_sets
from zsdist.roles.shapes import SHAPES
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Level, count_transitions


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("set") / "set", 3)


@pytest.fixture(scope="module")
def counts(made):
    return {level: sum(map(count_transitions, made.trajectories(level))) for level in Level}


def begin(folder, sets, *overrides, index=0, epoch=1, restored=None):
    settings = config.load(overrides=overrides)
    transport = MemoryTransport(MemoryBroker())
    context = Context(settings, "test", "replay", str(index), epoch, transport, threading.Event())
    return Replay(context, SHAPES, folder, restored, sets)


def held(replay):
    return {level: each.counts() | {"size": len(each.buffer)} for level, each in replay.level_replays.items()}


def test_recorded_transitions_are_in_the_ring_and_in_the_books(tmp_path, made, counts):
    replay = begin(tmp_path, [made])
    for level, found in held(replay).items():
        assert found["produced"] == found["stored"] == found["size"] == counts[level] > 0
        assert not (found["rejected"] or found["duplicates"] or found["abandoned_at_most"])
        assert replay.level_replays[level].limiter.stored == counts[level]
        assert not replay.level_replays[level].inbox.open_streams()


def test_a_successor_has_them_from_the_journal_and_a_resumed_run_from_its_checkpoint_each_once(tmp_path, made):
    first = begin(tmp_path / "a", [made])
    again = begin(tmp_path / "a", [made], epoch=2)
    resumed = begin(tmp_path / "b", [], epoch=3, restored=first.state())
    assert held(again) == held(first) == held(resumed)


def test_shards_divide_them(tmp_path, made, counts):
    two = ("replay.shards=2", "run.actors=2")
    shards = [begin(tmp_path / str(index), [made], *two, index=index) for index in range(2)]
    for level in Level:
        parts = [held(shard)[level]["stored"] for shard in shards]
        assert sum(parts) == counts[level] and min(parts) > 0


def test_a_run_begins_with_them_and_has_them_once_however_often_it_is_resumed(tmp_path, made, counts):
    first = rehearse(start(tmp_path / "run", f"replay.start_from=[{made.folder}]", "run.episodes=2"))
    moved = made.folder.rename(made.folder.with_name("moved"))
    try:
        second = rehearse(resume(tmp_path / "run", "run.episodes=4"))
    finally:
        moved.rename(made.folder)
    for summary in (first, second):
        for level, found in summary["transitions"].items():
            assert found["produced"] == found["stored"] == summary["env_steps"] + counts[level]
            assert found["sampled"] > 0
    assert second["env_steps"] > first["env_steps"]


def test_a_set_that_does_not_fit_ends_the_start_in_one_line(tmp_path, made):
    with pytest.raises(RunError, match=r"replay-0: recorded set .* discounts\.low 0\.95 and this run has 0\.5"):
        rehearse(start(tmp_path / "run", f"replay.start_from=[{made.folder}]", "low.discount=0.5"))
    assert len(recorded_sets(config.load(overrides=(f"replay.start_from=[{made.folder}]",)))) == 1
