"""A message is accepted only under a key that agrees with it about the sender."""

import numpy as np
import pytest
from wire_messages import every_message

from zsdist.errors import DecodeError
from zsdist.wire import addresses, keys
from zsdist.wire.messages import (
    EPISODES,
    Ack,
    Admission,
    Candidate,
    Jobs,
    Orders,
    Push,
    Records,
    SampleReply,
    SampleRequest,
    WeightsMessage,
)

MESSAGES = every_message(np.random.default_rng(0))


def key_of(message, run="run"):
    match message:
        case Push():
            return keys.push(run, message.stream, message.actor, message.epoch)
        case Records():
            return keys.episodes(run, message.actor, message.epoch)
        case Ack():
            return keys.ack(run, message.actor)
        case SampleRequest() | SampleReply():
            return keys.sample(run, message.level)
        case WeightsMessage():
            return keys.weights(run, message.weights.level)
        case Candidate():
            return keys.candidate(run, message.level, message.name)
        case Admission():
            return keys.join(run, message.actor)
        case Jobs():
            return keys.evaluation(run, message.actor)
        case Orders():
            return keys.control(run, message.role)
    return keys.control(run, message.role) if hasattr(message, "role") else keys.priority(run, message.level)


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_a_message_passes_under_its_own_key_and_under_no_other(message):
    own = key_of(message)
    addresses.require(own, "run", message)
    others = {key_of(other) for other in MESSAGES} | {key_of(message, "other"), keys.events("run"), "nonsense", ""}
    others |= {keys.push("run", "low", "a-1", 4), keys.push("run", "low", "a-0", 5), keys.ack("run", "a-1")}
    for key in others - {own}:
        with pytest.raises(DecodeError) as refused:
            addresses.require(key, "run", message)
        assert refused.value.reason == "key"


def test_results_of_drives_pass_under_the_key_of_their_jobs():
    records = Records("evaluation", "a-0", 4, 0, 1, False, ({},))
    addresses.require(keys.evaluation("run", "a-0"), "run", records)
    assert records.stream != EPISODES
    with pytest.raises(DecodeError):
        addresses.require(keys.evaluation("run", "a-1"), "run", records)
