from functools import partial

import pytest
from fakes import FakeVisualAct, LatticeEnv

from zsdist.config import Config
from zsdist.dqn import network
from zsdist.driving.actor_car import ActorCar, EpisodeTask
from zsdist.driving.perception import Perception
from zsdist.planning.grid import Grid
from zsdist.roles.shapes import SHAPES
from zsdist.sim.scenes import families
from zsdist.types import Level

SCENE = families.draw("iid", "train", 0)
Q = {
    level: partial(network.apply, network.initial_parameters(shape.state_size, shape.actions, (8,), seed=0))
    for level, shape in SHAPES.items()
}


@pytest.fixture
def perception():
    return Perception(FakeVisualAct(), Grid(), "all", None)


def begun(car=None, most_steps=6, **task):
    car = car or ActorCar(LatticeEnv(), Config())
    car.begin(EpisodeTask(SCENE, 3, 0.5, True, (1,), most_steps=most_steps, **task), {Level.HIGH: 1, Level.LOW: 2})
    return car


def drive(car, perception, steps=99):
    """Drive for a number of steps, or until the last state was observed; return the trajectories."""
    trajectories = []
    for _ in range(steps):
        ended = car.over
        car.advance(*perception.views([car]), Q)
        trajectories += car.drain()
        if ended:
            break
    return trajectories


def count(trajectories, level):
    return sum(len(trajectory) for trajectory in trajectories if trajectory.level is level)


def test_a_training_episode_is_recorded_and_a_drive_of_a_candidate_is_not(perception):
    car = begun()
    trajectories = drive(car, perception)
    record = car.record()
    assert [count(trajectories, level) for level in Level] == [record["steps"]] * 2 == [6, 6]
    assert (record["episode"], record["high_version"], record["low_version"]) == (3, 1, 2)
    begun(car, candidate="recent", merge=4)
    assert drive(car, perception) == []
    record = car.record()
    assert (record["scene_index"], record["merge"], record["candidate"]) == (3, 4, "recent")
    begun(car)
    assert count(drive(car, perception), Level.LOW) == 6, "the next training episode is recorded again"


def test_a_record_makes_the_car_idle(perception):
    car = begun()
    drive(car, perception)
    assert not car.idle
    assert car.record()["outcome"] == "timeout"
    assert car.idle


def test_cutting_an_episode_returns_the_completed_steps_as_truncated(perception):
    car = begun()
    drained = drive(car, perception, steps=3)
    trajectories = drained + car.cut()
    assert [count(trajectories, level) for level in Level] == [2, 2] and car.idle
    assert all(trajectory.discounts[-1] > 0 for trajectory in trajectories[-2:])


def test_readings_are_remembered_for_training_episodes_only():
    assert begun().scene_hash == SCENE.hash()
    assert begun(candidate="recent").scene_hash is None
