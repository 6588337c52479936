"""What an episode costs the scheduler and its actors, among few actors and among many: messages, bytes, operations."""

from typing import NamedTuple

import pytest
from episode_records import RECORD
from operations import operations

from zsdist.config import parse
from zsdist.roles.base import HEARTBEAT_S, Context
from zsdist.roles.scheduler.role import Scheduler
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.wire import codec, keys
from zsdist.wire.messages import EPISODES, Jobs, Orders, Records

RUN, FEW, MANY = "many", 8, 512
EPISODE = RECORD | {"actor": "actor-0", "episode": 1}


class NoFiles:
    """Run log that writes nothing."""

    def episode(self, record):
        pass

    def metrics(self, row):
        pass

    def wall_s(self):
        return 0.0


class Cost(NamedTuple):
    episode: list  # what the end of an episode makes the scheduler send, without acknowledgements
    work: int  # operations for it
    heartbeat: list  # what it sends at a heartbeat


def cost_of_an_episode(actors, folder):
    broker, sent = MemoryBroker(), Mailbox(2**28)
    settings = {"run": {"actors": actors, "cars_per_actor": 1, "episodes": 10**6}, "merge": {"every_episodes": 0}}
    context = Context(parse(settings), RUN, "scheduler", "0", 1, MemoryTransport(broker))
    scheduler, others = Scheduler(context, NoFiles(), folder), MemoryTransport(broker)
    epochs = {f"actor-{index}": 1 for index in range(actors)}
    supervision = Orders(1, "scheduler", {"epochs": epochs, "restarts": {}, "interrupted": False})
    others.publish(keys.control(RUN, "scheduler"), codec.encode(supervision))
    for now in (0.0, 0.05):  # in the second step it gets the jobs that it has sent itself
        scheduler.step(now)
    for key in (keys.control(RUN, keys.ANY), keys.evaluation(RUN, keys.ANY)):
        others.subscribe(key, sent)
    frame = Records(EPISODES, "actor-0", 1, 0, 1, False, (EPISODE,))
    others.publish(keys.episodes(RUN, "actor-0", 1), codec.encode(frame))
    work = operations(lambda: scheduler.step(0.1))
    assert scheduler.finished_episodes == 1
    episode = [codec.decode(message.payload) for message in sent.drain()]
    scheduler.step(HEARTBEAT_S)
    return Cost(episode, work, sent.drain())


@pytest.fixture
def costs(tmp_path):
    return cost_of_an_episode(FEW, tmp_path / "few"), cost_of_an_episode(MANY, tmp_path / "many")


def test_the_end_of_an_episode_concerns_its_own_actor_alone(costs):
    for actors, cost in zip((FEW, MANY), costs, strict=True):
        (jobs,) = cost.episode
        assert isinstance(jobs, Jobs) and jobs.actor == "actor-0"
        assert jobs.content["leases"] == [actors + 1] and jobs.content["finished"] == 1


def test_the_end_of_an_episode_takes_as_much_work_among_many_actors_as_among_few(costs):
    few, many = costs
    assert many.work < 1.1 * few.work


def test_what_an_actor_receives_at_a_heartbeat_is_as_long_among_many_actors_as_among_few(costs):
    def bytes_for_one(cost):
        read = (keys.control(RUN, "actor"), keys.evaluation(RUN, "actor-0"))
        return sum(len(message.payload) for message in cost.heartbeat if message.key in read)

    few, many = map(bytes_for_one, costs)
    assert 0 < many <= few + 8  # numbers have more digits
