"""Content fits its model exactly or is refused; content that roles send fits."""

import pytest
from wire_messages import ACTOR, EPISODE, JOBS, LEARNER, REPLAY, RESULT, SUPERVISION

from zsdist.errors import DecodeError
from zsdist.roles import schemas
from zsdist.wire.messages import EPISODES, EVALUATION, Records, State

VALID = [
    (schemas.ActorOrders, ACTOR),
    (schemas.ReplayOrders, REPLAY),
    (schemas.LearnerOrders, LEARNER),
    (schemas.Supervision, SUPERVISION),
    (schemas.StateRequest, {"ask": "state"}),
    (schemas.ActorJobs, JOBS),
    (schemas.TrainingRecord, EPISODE),
    (schemas.CandidateRecord, RESULT),
]


@pytest.mark.parametrize(("model", "content"), VALID, ids=lambda value: getattr(value, "__name__", ""))
def test_valid_content_is_read_and_no_field_may_be_missing_or_of_another_type(model, content):
    assert schemas.read(model, content)
    for name in content.keys() - {"options"}:
        for changed in ({key: value for key, value in content.items() if key != name}, content | {name: {"x": None}}):
            with pytest.raises(DecodeError) as refused:
                schemas.read(model, changed)
            assert refused.value.reason == "content"


@pytest.mark.parametrize(
    ("model", "changed"),
    [
        (schemas.ActorOrders, ACTOR | {"more": 1}),
        (schemas.ActorOrders, ACTOR | {"finished": True}),
        (schemas.ActorOrders, ACTOR | {"finished": 1.0}),
        (schemas.ActorOrders, ACTOR | {"closing": 0}),
        (schemas.ReplayOrders, REPLAY | {"epochs": {"actor-0": -1}}),
        (schemas.ReplayOrders, REPLAY | {"epochs": {"a/b": 1}}),
        (schemas.ActorJobs, JOBS | {"epoch": -1}),
        (schemas.ActorJobs, JOBS | {"leases": [0]}),
        (schemas.ActorJobs, JOBS | {"leases": [1] * 300}),
        (schemas.ActorOrders, ACTOR | {"merge": 2**62}),
        (schemas.ReplayOrders, REPLAY | {"buffer_size": 0}),
        (schemas.ReplayOrders, REPLAY | {"batch_size": "16"}),
        (schemas.LearnerOrders, LEARNER | {"chosen": "worst"}),
        (schemas.LearnerOrders, LEARNER | {"candidates": ["worst"]}),
        (schemas.StateRequest, {"ask": "money"}),
        (schemas.ActorJobs, JOBS | {"drives": [["recent"]]}),
        (schemas.ActorJobs, JOBS | {"drives": [["recent", 0.5]]}),
        (schemas.TrainingRecord, EPISODE | {"outcome": "victory"}),
        (schemas.TrainingRecord, EPISODE | {"return": 1e300}),
        (schemas.TrainingRecord, EPISODE | {"epsilon": 2.0}),
        (schemas.TrainingRecord, EPISODE | {"path": [[0.0]]}),
        (schemas.TrainingRecord, EPISODE | {"options": [1]}),
        (schemas.TrainingRecord, EPISODE | {"scene": "s" * 2000}),
        (schemas.TrainingRecord, EPISODE | {"episode": 2**40}),
    ],
)
def test_almost_valid_content_is_refused(model, changed):
    with pytest.raises(DecodeError, match=model.__name__):
        schemas.read(model, changed)


def test_a_frame_contains_only_records_of_its_actor_and_stream():
    def frame(stream, *records):
        return Records(stream, "actor-0", 1, 0, len(records), False, records)

    assert len(schemas.check_records(frame(EPISODES, EPISODE, EPISODE))) == 2
    assert len(schemas.check_records(frame(EVALUATION, RESULT))) == 1
    for stream, record, reason in (
        (EPISODES, RESULT, "content"),
        (EVALUATION, EPISODE, "content"),
        (EPISODES, EPISODE | {"actor": "actor-1"}, "actor"),
    ):
        with pytest.raises(DecodeError) as refused:
            schemas.check_records(frame(stream, record))
        assert refused.value.reason == reason


def test_a_state_without_counts_or_versions_is_refused():
    level_replay = {"open": 0, "books": {"produced": 1}, "more": []}
    learner = {"version": 1, "updates": 1, "merge": 0, "sha256": "0" * 64}
    assert len(schemas.check_state(State("replay", {"low": level_replay, "high": level_replay}, {}))) == 2
    assert schemas.check_state(State("learner-low", learner, {}))
    for state in (State("replay", {"low": {}}, {}), State("learner-low", learner | {"sha256": 1}, {})):
        with pytest.raises(DecodeError):
            schemas.check_state(state)
