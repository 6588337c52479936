import math

import numpy as np
import pytest
from fakes import LatticeEnv

from zsdist.config import load
from zsdist.driving.episode import Episode
from zsdist.errors import RunError
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


class Broken(LatticeEnv):
    """Environment whose third step returns a number that is not finite."""

    wrong, steps = "reward", 0

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        self.steps += 1
        if self.steps == 3 and self.wrong == "reward":
            info = info | {"reward_terms": info["reward_terms"] | {"distance": math.nan}}
        elif self.steps == 3:
            observation = observation | {"pose": np.array([math.inf, 0.0, 0.0])}
        return observation, reward, terminated, truncated, info


@pytest.mark.parametrize("wrong", ["reward", "pose"])
def test_a_number_of_the_environment_that_is_not_finite_goes_no_further(wrong):
    env = Broken()
    env.wrong = wrong
    episode = Episode(env, OPEN)
    for _ in range(2):
        episode.step(Action.FORWARD)
    with pytest.raises(RunError, match="pose and rewards of the environment hold"):
        episode.step(Action.FORWARD)
    assert len(episode.rewards) == 2
