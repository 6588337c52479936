import dataclasses

import numpy as np
import pytest

from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.protocol.outbox import REFUSED_S
from zsdist.roles.actor_outboxes import ActorOutboxes, CreditAccount
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Ack, Level, Trajectory
from zsdist.wire import codec, keys
from zsdist.wire.messages import EPISODES, EVALUATION

SETTINGS = Config().transport


def trajectory(level, steps):
    return Trajectory(
        level=level,
        states=np.zeros((steps + 1, 3), np.float32),
        actions=np.zeros(steps, np.uint8),
        rewards=np.zeros(steps, np.float32),
        discounts=np.ones(steps, np.float32),
        successors=np.arange(1, steps + 1, dtype=np.uint16),
        masks=np.ones((steps + 1, 5), bool),
        guides=np.zeros(steps, np.int8),
        behaviours=np.zeros(steps, np.uint8),
        weight_version=1,
    )


@pytest.fixture
def outboxes():
    return ActorOutboxes("run", "actor-0", 7, SETTINGS)


def grant(outboxes, credit, now=0.0):
    for level in Level:
        outboxes.on_ack(Ack(1, "actor-0", 7, level, 0, credit), now)


def driven(outboxes, steps):
    """Return the account of a car that has driven a number of steps."""
    account = CreditAccount()
    for _ in range(steps):
        assert outboxes.reserve(account)
        account.count_step()
    return account


def test_without_credit_no_step_may_be_driven(outboxes):
    account = CreditAccount()
    assert not outboxes.reserve(account)
    grant(outboxes, 2)
    assert outboxes.reserve(account) and account.reserved == {Level.HIGH: 1, Level.LOW: 1}


def test_a_step_reserves_one_transition_of_each_level_beside_those_pending(outboxes):
    grant(outboxes, 3)
    account = driven(outboxes, 3)
    assert not outboxes.reserve(account)
    assert account.reserved == account.pending == {Level.HIGH: 3, Level.LOW: 3}


def test_trajectories_use_up_their_credit_and_the_rest_can_be_released(outboxes):
    grant(outboxes, 4)
    account, other = driven(outboxes, 3), CreditAccount()
    assert outboxes.reserve(account)
    outboxes.offer([trajectory(level, 3) for level in Level], account)
    assert account.reserved == {Level.HIGH: 1, Level.LOW: 1} and set(account.pending.values()) == {0}
    assert not outboxes.reserve(other)
    outboxes.release(account)
    assert set(account.reserved.values()) == {0} and outboxes.reserve(other)


def test_every_stream_goes_out_under_its_own_key(outboxes):
    transport, sent = MemoryTransport(MemoryBroker()), []
    transport.publish = lambda key, payload: sent.append((key, codec.decode(payload)))
    grant(outboxes, None)
    outboxes.offer([trajectory(level, 20) for level in Level], driven(outboxes, 20))
    for stream in (EPISODES, EVALUATION):
        outboxes.offer_record(stream, {"episode": 1})
    outboxes.flush(transport, 0.0)
    assert dict(sent).keys() == {
        keys.push("run", Level.HIGH, "actor-0", 7),
        keys.push("run", Level.LOW, "actor-0", 7),
        keys.episodes("run", "actor-0", 7),
        keys.evaluation("run", "actor-0"),
    }
    assert outboxes.statistics()["episodes_produced"] == 1


def test_a_frame_that_a_living_receiver_does_not_acknowledge_ends_the_run(outboxes):
    transport = MemoryTransport(MemoryBroker())
    heard_s = np.arange(0.0, SETTINGS.give_up_after_s + 2.0)
    grant(outboxes, None)
    outboxes.offer([trajectory(Level.LOW, 20)], driven(outboxes, 20))
    outboxes.flush(transport, 0.0)
    for now in heard_s:
        grant(outboxes, None, now)
    with pytest.raises(RunError, match="stream 'low' has gone unacknowledged for 60 s"):
        outboxes.flush(transport, heard_s[-1])


def test_refused_transitions_end_the_run_with_the_reason_long_before_silence_does(outboxes):
    transport = MemoryTransport(MemoryBroker())
    grant(outboxes, None)
    outboxes.offer([trajectory(Level.LOW, 20)], driven(outboxes, 20))
    outboxes.flush(transport, 0.0)
    for now in np.arange(0.0, REFUSED_S + 1.0):
        outboxes.on_ack(Ack(1, "actor-0", 7, Level.LOW, 0, None, "range: weight version"), now)
    with pytest.raises(RunError, match="actor-0: transitions of the low level are refused by their receiver: range"):
        outboxes.flush(transport, REFUSED_S + 1.0)


@pytest.mark.parametrize(("name", "value"), [("rewards", np.inf), ("states", 1e6)])
def test_transitions_that_cannot_be_sent_are_named_with_what_is_allowed(outboxes, name, value):
    grant(outboxes, None)
    column = getattr(trajectory(Level.HIGH, 20), name)
    wrong = dataclasses.replace(trajectory(Level.HIGH, 20), **{name: np.full_like(column, value)})
    outboxes.offer([wrong], driven(outboxes, 20))
    with pytest.raises(RunError, match=f"transitions of the high level cannot be sent: nonfinite: column '{name}'"):
        outboxes.flush(MemoryTransport(MemoryBroker()), 0.0)


def test_a_car_that_was_cut_short_needs_no_credit_for_the_steps_it_lost(outboxes):
    grant(outboxes, 3)
    account = driven(outboxes, 3)
    outboxes.release(account)
    assert sum(outboxes.reserve(CreditAccount()) for _ in range(2)) == 2
    assert outboxes.reserve(account)


def test_a_frame_says_whether_all_before_it_are_acknowledged():
    broker, outboxes = MemoryBroker(), ActorOutboxes("run", "actor-0", 7, SETTINGS)
    transport, replay, box = MemoryTransport(broker), MemoryTransport(broker), Mailbox(2**20)
    replay.subscribe(keys.push("run", Level.LOW, "actor-0", 7), box)

    def sent(now):
        outboxes.flush(transport, now)
        return [(push.sequence, push.first) for push in (codec.decode(message.payload) for message in box.drain())]

    grant(outboxes, 200)
    account = driven(outboxes, 60)
    outboxes.offer([trajectory(Level.LOW, 20)], account)
    assert sent(0.0) == [(0, True)]
    outboxes.offer([trajectory(Level.LOW, 20)], account)
    assert sent(0.01) == [(1, False)]
    outboxes.on_ack(Ack(1, "actor-0", 7, Level.LOW, 1, 200), 0.02)
    assert (1, True) in sent(5.0)
