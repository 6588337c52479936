import pytest

from zsdist.config import parse
from zsdist.roles.scheduler.checkpointing import ANSWER_WITHIN_S, Answer, StateCollection
from zsdist.wire.messages import State

NAMES = ["replay", "replay-1", "learner-high", "learner-low"]


def state(role, frames_expected=0):
    level_replay = {"open": frames_expected}
    meta = {"high": level_replay, "low": level_replay} if role.startswith("replay") else {}
    return Answer(State(role, meta, {}), b"")


@pytest.fixture
def collection():
    return StateCollection(parse({"replay": {"shards": 2}, "run": {"actors": 2}}))


def test_all_roles_with_a_state_are_asked_once_and_again_where_they_do_not_answer(collection):
    assert collection.due(0.0) == NAMES
    assert collection.due(ANSWER_WITHIN_S - 0.1) == []
    collection.accept(state("learner-low"))
    assert collection.due(ANSWER_WITHIN_S) == NAMES[:-1]


def test_states_are_given_once_and_only_when_all_are_there(collection):
    for name in NAMES:
        assert collection.take() is None
        collection.accept(state(name))
    taken = collection.take()
    assert sorted(taken) == sorted(NAMES) and all(taken[name].state.role == name for name in NAMES)
    assert collection.take() is None
    assert collection.due(0.1) == NAMES  # for the next checkpoint, at once


def test_a_shard_that_still_expects_frames_is_asked_again_soon(collection):
    collection.due(0.0)
    for name in NAMES:
        collection.accept(state(name, frames_expected=name == "replay-1"))
    collection.drop_open(1.0)
    assert collection.take() is None
    assert collection.due(1.0) == []
    assert collection.due(1.0 + ANSWER_WITHIN_S / 10) == ["replay-1"]
    collection.accept(state("replay-1"))
    collection.drop_open(3.0)
    assert collection.take() is not None


def test_cleared_states_are_asked_for_anew(collection):
    collection.due(0.0)
    collection.accept(state("replay"))
    collection.clear()
    assert collection.due(0.1) == NAMES
