import threading

import pytest

from zsdist.config import parse
from zsdist.dqn import network
from zsdist.driving.perception import Perception
from zsdist.roles.actor import Actor
from zsdist.roles.base import Context
from zsdist.roles.shapes import SHAPES
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Level, Weights
from zsdist.wire import codec, keys
from zsdist.wire.messages import WeightsMessage

RUN, CONFIG = "test", parse({})
LOW = SHAPES[Level.LOW]
PARAMETERS = network.initial_parameters(LOW.state_size, LOW.actions, (4,), seed=0)


class Blind(Perception):
    def __init__(self):
        pass

    def statistics(self):
        return {}


@pytest.fixture
def bench():
    return Bench()


class Bench:
    """An actor without cars, and a learner played by the test."""

    def __init__(self):
        broker = MemoryBroker()
        self.others = MemoryTransport(broker)
        context = Context(CONFIG, RUN, "actor", "0", 1, MemoryTransport(broker), threading.Event())
        self.actor = Actor(context, [], Blind(), None)

    def say(self, version, made_s, epoch=1):
        message = WeightsMessage(epoch, 0, network.sha256(PARAMETERS), made_s, Weights(Level.LOW, version, PARAMETERS))
        self.others.publish(keys.weights(RUN, Level.LOW), codec.encode(message))

    def told(self, now):
        self.actor.step(now)
        return self.actor.statistics()


def test_the_first_weights_of_an_actor_are_not_late(bench):
    bench.say(7, 10.0)
    told = bench.told(400.0)
    assert "low_weights_lag_s" not in told
    assert told["weights_max_lag_s"] == 0.0


def test_weights_lag_by_the_time_from_their_making_to_their_use(bench):
    bench.say(7, 10.0)
    bench.told(10.1)
    bench.say(8, 11.0)
    assert bench.told(11.25)["low_weights_lag_s"] == pytest.approx(0.25)
    bench.say(9, 12.0)
    told = bench.told(12.1)
    assert told["low_weights_lag_s"] == pytest.approx(0.1)
    assert told["weights_max_lag_s"] == pytest.approx(0.25)


def test_where_versions_were_missed_the_lag_counts_from_the_version_held(bench):
    bench.say(7, 10.0)
    bench.told(10.1)
    bench.say(9, 13.0)
    assert bench.told(13.1)["low_weights_lag_s"] == pytest.approx(3.1)


def test_weights_said_again_and_those_of_a_learner_that_was_replaced_change_no_lag(bench):
    bench.say(7, 10.0, epoch=3)
    bench.told(10.1)
    bench.say(7, 10.0, epoch=3)
    bench.say(8, 50.0, epoch=2)
    assert "low_weights_lag_s" not in bench.told(60.0)
    assert bench.told(60.1)["low_weight_version"] == 7


def test_the_weights_of_a_learner_that_follows_another_lag_from_their_own_making(bench):
    bench.say(7, 10.0)
    bench.told(10.1)
    bench.say(3, 200.0, epoch=5)
    assert bench.told(200.5)["low_weights_lag_s"] == pytest.approx(0.5)
