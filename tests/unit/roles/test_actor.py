import threading

import pytest
from flow import InstantCar, NoPictures, NoScenes

from zsdist.config import parse
from zsdist.dqn import network
from zsdist.driving.perception import Perception
from zsdist.errors import RunError
from zsdist.roles.actor import Actor
from zsdist.roles.base import Context
from zsdist.roles.shapes import SHAPES
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Ack, Level, Weights
from zsdist.wire import codec, keys
from zsdist.wire.messages import Jobs, Orders, WeightsMessage

RUN, CONFIG = "test", parse({})
LOW = SHAPES[Level.LOW]
PARAMETERS = network.initial_parameters(LOW.state_size, LOW.actions, (4,), seed=0)


class NoPerception(Perception):
    def __init__(self):
        pass

    def statistics(self):
        return {}


@pytest.fixture
def bench():
    return Bench()


class Bench:
    """Actor without cars; the test plays a learner."""

    def __init__(self):
        broker = MemoryBroker()
        self.others = MemoryTransport(broker)
        context = Context(CONFIG, RUN, "actor", "0", 1, MemoryTransport(broker), threading.Event())
        self.actor = Actor(context, [], NoPerception(), None)

    def publish(self, version, made_s, epoch=1):
        message = WeightsMessage(epoch, 0, network.sha256(PARAMETERS), made_s, Weights(Level.LOW, version, PARAMETERS))
        self.others.publish(keys.weights(RUN, Level.LOW), codec.encode(message))

    def statistics(self, now):
        self.actor.step(now)
        return self.actor.statistics()


def test_the_first_weights_of_an_actor_are_not_late(bench):
    bench.publish(7, 10.0)
    statistics = bench.statistics(400.0)
    assert "low_weights_lag_s" not in statistics
    assert statistics["weights_max_lag_s"] == 0.0


def test_weights_lag_by_the_time_from_their_making_to_their_use(bench):
    bench.publish(7, 10.0)
    bench.statistics(10.1)
    bench.publish(8, 11.0)
    assert bench.statistics(11.25)["low_weights_lag_s"] == pytest.approx(0.25)
    bench.publish(9, 12.0)
    statistics = bench.statistics(12.1)
    assert statistics["low_weights_lag_s"] == pytest.approx(0.1)
    assert statistics["weights_max_lag_s"] == pytest.approx(0.25)


def test_after_missed_versions_the_lag_counts_from_the_version_held(bench):
    bench.publish(7, 10.0)
    bench.statistics(10.1)
    bench.publish(9, 13.0)
    assert bench.statistics(13.1)["low_weights_lag_s"] == pytest.approx(3.1)


def test_repeated_weights_and_those_of_a_replaced_learner_change_no_lag(bench):
    bench.publish(7, 10.0, epoch=3)
    bench.statistics(10.1)
    bench.publish(7, 10.0, epoch=3)
    bench.publish(8, 50.0, epoch=2)
    assert "low_weights_lag_s" not in bench.statistics(60.0)
    assert bench.statistics(60.1)["low_weight_version"] == 7


def test_weights_of_a_new_learner_lag_by_the_time_from_their_own_making(bench):
    bench.publish(7, 10.0)
    bench.statistics(10.1)
    bench.publish(3, 200.0, epoch=5)
    assert bench.statistics(200.5)["low_weights_lag_s"] == pytest.approx(0.5)


class RichCar(InstantCar):
    """Car whose episodes return more than a record may say."""

    def record(self):
        return super().record() | {"return": 1e38}


def test_a_record_that_would_be_refused_ends_the_run_at_once_with_its_value():
    broker = MemoryBroker()
    others = MemoryTransport(broker)
    context = Context(CONFIG, RUN, "actor", "0", 1, MemoryTransport(broker), threading.Event())
    actor = Actor(context, [RichCar()], NoPictures(), NoScenes())
    for level in Level:
        shape = SHAPES[level]
        parameters = network.initial_parameters(shape.state_size, shape.actions, (4,), seed=0)
        message = WeightsMessage(1, 0, network.sha256(parameters), 1.0, Weights(level, 1, parameters))
        others.publish(keys.weights(RUN, level), codec.encode(message))
        others.publish(keys.ack(RUN, "actor-0"), codec.encode(Ack(1, "actor-0", 1, level, 0, None)))
    jobs = {"epoch": 1, "leases": [1], "finished": 0, "merge": 0, "drives": []}
    others.publish(keys.evaluation(RUN, "actor-0"), codec.encode(Jobs(1, "actor-0", jobs)))
    with pytest.raises(RunError, match=r"actor-0: the record of an episode is out of range: .*return is 1e\+38"):
        for now in (0.0, 0.1, 0.2):
            actor.step(now)


def test_an_actor_that_is_told_to_leave_cuts_its_cars_and_closes_its_streams_whatever_the_orders_say(bench):
    car = InstantCar()
    bench.actor.cars = [car]
    bench.actor.perception = NoPictures()
    car.begin(None, {})
    content = {"finished": 0, "merge": 1, "closing": False, "cut": False}
    jobs = {"epoch": 1, "leases": [], "finished": 0, "merge": 0, "drives": []}
    bench.actor.leave()
    bench.others.publish(keys.control(RUN, "actor"), codec.encode(Orders(1, "actor", content)))
    bench.others.publish(keys.evaluation(RUN, "actor-0"), codec.encode(Jobs(1, "actor-0", jobs)))
    statistics = bench.statistics(1.0)
    assert car.idle and bench.actor.is_named and statistics["episodes_unacknowledged_frames"] == 1
    bench.others.publish(keys.evaluation(RUN, "actor-0"), codec.encode(Jobs(1, "actor-0", jobs | {"epoch": None})))
    bench.statistics(2.0)
    assert not bench.actor.is_named and not bench.actor.finished
    for stream in ("high", "low", "episodes", "evaluation"):
        bench.others.publish(keys.ack(RUN, "actor-0"), codec.encode(Ack(1, "actor-0", 1, stream, 1, None)))
    bench.statistics(3.0)
    assert bench.actor.finished
