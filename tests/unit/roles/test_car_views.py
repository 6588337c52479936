import json

import pytest

from zsdist.config import Config
from zsdist.roles import car_views
from zsdist.roles.car_views import CarViews
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.wire import keys

RUN = "test"


class IdleCar:
    """Car without a task, which counts how often it was looked at."""

    candidate_q = None

    def __init__(self):
        self.looks = 0

    @property
    def idle(self):
        self.looks += 1
        return True


class Watched:
    def __init__(self):
        broker = MemoryBroker()
        self.watcher, self.actor = MemoryTransport(broker), MemoryTransport(broker)
        self.cars, questions = [IdleCar(), IdleCar()], Mailbox(2**20)
        self.actor.serve(keys.view(RUN, "actor-0", keys.ANY), questions)
        self.views = CarViews(questions, "actor-0", Config())

    def ask(self, now, car):
        answers = Mailbox(2**20)
        self.watcher.request(keys.view(RUN, "actor-0", car), b"", answers, timeout_s=1.0)
        self.views.answer(now, self.cars, dict)
        return [json.loads(answer.payload) for answer in answers.drain()]

    @property
    def looks(self):
        return [car.looks for car in self.cars]


@pytest.fixture
def watched():
    return Watched()


def test_nobody_looks_at_cars_while_nobody_asks(watched):
    watched.views.answer(1.0, watched.cars, dict)
    assert watched.looks == [0, 0]


def test_one_question_tells_where_all_cars_are_and_another_one_shows_one(watched):
    idle = [{"car": 0, "kind": "idle"}, {"car": 1, "kind": "idle"}]
    assert watched.ask(1.0, "all") == [{"time_s": 1.0, "actor": "actor-0", "cars": idle}]
    assert watched.ask(1.0, 1) == [{"time_s": 1.0, "actor": "actor-0", "car": 1, "kind": "idle"}]


def test_a_car_is_looked_at_at_most_twice_a_second_however_many_ask(watched):
    for tick in range(40):
        assert len(watched.ask(1.0 + tick / 40, 1)) == 1, "each question is answered"
    once, car = watched.looks[1], IdleCar()
    watched.cars = [IdleCar(), car]
    watched.ask(2.0, 1)
    assert once == 2 * car.looks
    assert watched.ask(1.2, 1)[0]["time_s"] == 1.2, "a clock that was put back holds nothing up"


@pytest.mark.parametrize("car", ["2", "-1", "00", "none"])
def test_a_car_that_is_not_there_gets_no_answer(watched, car):
    assert watched.ask(1.0, car) == []


def test_the_page_and_the_actor_mean_the_same_by_all_cars():
    from zsdist.web import live

    assert live.ALL == car_views.ALL
