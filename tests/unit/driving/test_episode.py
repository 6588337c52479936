import math

import numpy as np
import pytest
from fakes import LatticeEnv

from zsdist.config import load
from zsdist.driving.episode import Episode
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Action, Outcome

OPEN = Scene("open", "grass", Start(-5.3125, 0.3125, 0.0), (5.9375, 0.3125), ())
POLE = Scene("pole", "grass", OPEN.start, OPEN.goal, (Obstacle("pole", 0.0, 0.3125, radius_m=0.2),))


def drive(scene, action=Action.FORWARD, most_steps=math.inf, **config):
    episode = Episode(LatticeEnv(config=load(**config)), scene, most_steps)
    results = []
    while not episode.over:
        results.append(episode.step(action))
    return episode, results


def test_an_episode_begins_at_the_start_of_its_scene():
    episode = Episode(LatticeEnv(), OPEN)
    assert episode.poses == [episode.pose] and episode.pose == pytest.approx(OPEN.start.pose)
    assert episode.goal == OPEN.goal and not episode.over and episode.outcome is None


@pytest.mark.parametrize(("scene", "outcome"), [(OPEN, Outcome.SUCCESS), (POLE, Outcome.COLLISION)])
def test_goal_and_obstacle_terminate_an_episode(scene, outcome):
    episode, results = drive(scene)
    assert episode.outcome is outcome
    assert [result.outcome for result in results] == [None] * (len(results) - 1) + [outcome]


def test_every_action_adds_a_pose_and_its_rewards():
    episode, results = drive(OPEN)
    assert episode.rewards == [result.terms for result in results]
    assert len(episode.poses) == len(results) + 1
    np.testing.assert_array_equal(episode.observation["pose"], episode.pose)


def test_the_step_limits_of_environment_and_task_truncate_an_episode():
    for limits in ({"overrides": ("sim.max_steps=5",)}, {"most_steps": 5}):
        episode, results = drive(OPEN, Action.TURN_LEFT_90, **limits)
        assert episode.outcome is Outcome.TIMEOUT
        assert [result.outcome for result in results] == [None] * 4 + [Outcome.TIMEOUT]
