import json

import pytest

from zsdist.telemetry import snapshot as snapshots
from zsdist.telemetry.snapshot import Snapshot
from zsdist.transport.base import Message
from zsdist.types import Level
from zsdist.wire import keys


def stats(role, identifier, **fields):
    about = {"time_s": 0.0, "role": role, "id": identifier}
    return Message(keys.stats("run", role, identifier), json.dumps(about | fields).encode())


def test_lag_is_that_of_the_actor_with_the_oldest_weights():
    snapshot = Snapshot()
    snapshot.update([stats("learner", "low", weight_version=9), stats("learner", "high", weight_version=4)])
    snapshot.update([stats("actor", "0", low_weight_version=8, high_weight_version=4)])
    snapshot.update([stats("actor", "1", low_weight_version=5, high_weight_version=4)])
    assert snapshot.lag_versions() == {Level.LOW: 4, Level.HIGH: 0}
    snapshot.update([stats("actor", "1", low_weight_version=9, high_weight_version=4)])
    assert snapshot.lag_versions()[Level.LOW] == 1
    assert snapshot.max_lag_versions >= 4


def test_the_longest_lag_is_found_whichever_message_shows_it():
    snapshot = Snapshot()
    snapshot.update([stats("learner", "low", weight_version=9), stats("actor", "0", low_weight_version=7)])
    assert snapshot.max_lag_versions == 2
    snapshot.update([stats("actor", "1", low_weight_version=5, high_weight_version=3)])
    assert snapshot.max_lag_versions == 4
    snapshot.update([stats("actor", "1", low_weight_version=9), stats("learner", "low", weight_version=20)])
    assert snapshot.max_lag_versions == 13
    snapshot.update([stats("actor", "0", low_weight_version=20), stats("actor", "1", low_weight_version=20)])
    assert (snapshot.max_lag_versions, snapshot.lag_versions()[Level.LOW]) == (13, 0)


def test_the_time_for_a_message_does_not_grow_with_the_number_of_actors(monkeypatch):
    snapshot, asked = Snapshot(), []
    snapshot.update(stats("actor", str(index), low_weight_version=1) for index in range(500))
    monkeypatch.setattr(Snapshot, "of", lambda self, role: asked.append(role) or {})
    snapshot.update(stats("actor", str(index), low_weight_version=2) for index in range(500))
    assert not asked


def test_lag_in_seconds_is_that_of_the_latest_actor_and_the_longest_is_kept():
    snapshot = Snapshot()
    for identifier, lag_s in (("0", 0.2), ("1", 0.7)):
        snapshot.update([stats("actor", identifier, low_weights_lag_s=lag_s, weights_max_lag_s=lag_s)])
    assert snapshot.row()["low_weights_lag_s"] == 0.7
    snapshot.update([stats("actor", "1", low_weights_lag_s=0.1, weights_max_lag_s=0.7)])
    assert snapshot.row()["low_weights_lag_s"] == 0.2
    assert snapshot.max_lag_s == 0.7


def test_a_row_combines_the_shards_of_the_replay():
    snapshot = Snapshot()
    first = {"low_stored": 300, "low_sampled": 900, "low_samples_per_insert": 3.0, "low_batch_size": 16}
    second = {"low_stored": 100, "low_sampled": 100, "low_samples_per_insert": 1.0, "low_batch_size": 16}
    snapshot.update([stats("replay", "0", low_oldest_version=7, **first), stats("replay", "1", **second)])
    row = snapshot.row()
    assert (row["replay_low_stored"], row["replay_low_batch_size"], row["replay_low_oldest_version"]) == (400, 16, 7)
    assert row["replay_low_samples_per_insert"] == 2.5


def test_a_rate_is_the_growth_of_a_counter_summed_over_instances():
    snapshot = Snapshot()
    for second in range(4):
        snapshot.update(
            [
                stats("actor", name, time_s=float(second), env_steps=second * pace)
                for name, pace in (("0", 10), ("1", 5))
            ]
        )
    assert snapshot.rate("actor", "env_steps") == pytest.approx(15)
    assert snapshot.row()["env_steps_per_s"] == pytest.approx(15)


def test_a_counter_that_restarts_gives_no_negative_rate():
    snapshot = Snapshot()
    for second, (epoch, steps) in enumerate(((3, 100), (3, 110), (7, 0), (7, 10))):
        snapshot.update([stats("actor", "0", time_s=float(second), epoch=epoch, env_steps=steps)])
    assert snapshot.rate("actor", "env_steps") == pytest.approx(10)


def test_a_role_that_waits_is_named_with_the_reason():
    snapshot = Snapshot()
    for second in range(4):
        snapshot.update([stats("learner", "low", time_s=float(second), waiting_data_s=0.9 * second)])
    assert snapshot.waits() == ["learner low for data"]


def test_liveliness_comes_and_goes():
    snapshot, key = Snapshot(), keys.alive("run", "actor", "0")
    snapshot.update([Message(key, b"1")])
    assert snapshot.alive == {("actor", "0")}
    snapshot.update([Message(key, b"0")])
    assert snapshot.alive == set()


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"{",
        b"[1]",
        b"\xff\xfe",
        b"null",
        b'{"role": "actor", "id": "0"}',
        b'{"role": "actor", "id": "1", "time_s": 1}',
        b'{"role": "actor", "id": "0", "time_s": "late"}',
        b'{"role": "actor", "id": "0", "time_s": 1, "env_steps": "many"}',
        b'{"role": "actor", "id": "0", "time_s": 1, "env_steps": NaN}',
        b'{"role": "actor", "id": "0", "time_s": 1, "env_steps": [1]}',
    ],
)
def test_malformed_messages_are_counted_and_change_nothing(payload):
    snapshot = Snapshot()
    snapshot.update([Message(keys.stats("run", "actor", "0"), payload), Message("another/key", b"{}")])
    assert snapshot.malformed == 2
    assert snapshot.roles == {}


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"[" * 60_000,
        b"[1]",
        b"NaN",
        b'{"time_s": 1%s}' % (b"0" * 400),
        b'{"time_s": 1e400}',
        b'{"time_s": NaN}',
        b'{"time_s": {}}',
        b'{"time_s": 1, "more": "words"}',
        b'{"time_s": 1, "host": 5}',
        b'{"time_s": 1, "host": "\\u001b[2J"}',
        b'{"time_s": 1, "a b": 5}',
        b'{"time_s": 1, "host": "%s"}' % (b"x" * 70_000),
    ],
)
def test_invalid_statistics_are_counted_and_change_nothing(payload):
    snapshot = Snapshot()
    about = b'{"role": "actor", "id": "0", '
    snapshot.update([Message(keys.stats("run", "actor", "0"), payload.replace(b"{", about, 1))])
    snapshot.update([Message(keys.stats("run", "actor", "1"), payload.replace(b"{", about, 1))])
    snapshot.update([Message("nonsense", payload), Message(keys.push("run", "low", "a", 1), payload)])
    assert snapshot.malformed == 4
    assert not snapshot.roles and not snapshot.events
    assert snapshot.row()["actors_env_steps"] == 0


def test_fields_that_a_replay_leaves_out_count_as_zero_in_a_row():
    snapshot = Snapshot()
    snapshot.update([stats("replay", "0", low_samples_per_insert=3.0)])
    assert snapshot.row()["replay_low_samples_per_insert"] == 0.0


def test_no_more_roles_are_remembered_than_a_run_can_have(monkeypatch):
    monkeypatch.setattr(snapshots, "MAX_ROLES", 50)
    snapshot = Snapshot()
    snapshot.update(stats("actor", str(number)) for number in range(55))
    snapshot.update(Message(keys.alive("run", "actor", str(number)), b"1") for number in range(55))
    assert len(snapshot.roles) == len(snapshot.alive) == 50
    assert snapshot.malformed == 5


def test_actors_that_have_left_count_no_more():
    snapshot = Snapshot()
    actors = [stats("actor", identifier, low_weight_version=1, cars_driving=2) for identifier in ("0", "1", "2")]
    snapshot.update([stats("learner", "low", weight_version=9), *actors])
    event = {"time_s": 1.0, "event": "actor_left", "actor": "actor-2"}
    snapshot.update([Message(keys.events("run"), json.dumps(event).encode())])
    assert set(snapshot.of("actor")) == {"0", "1"}
    snapshot.keep_actors({"actor-1"})
    snapshot.update([stats("actor", "1", low_weight_version=9, cars_driving=1)])
    assert snapshot.lag_versions()[Level.LOW] == 0 and snapshot.total("actor", "cars_driving") == 1
