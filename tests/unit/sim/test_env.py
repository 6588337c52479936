import math
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.utils.env_checker import check_env

import zsdist  # noqa: F401  registers the environment
from zsdist.config import Config, parse
from zsdist.errors import ConfigError
from zsdist.sim.env import CarNavigation
from zsdist.sim.scenes.families import FAMILIES
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Action, Pose

CONFIG = parse({"camera": {"size_px": 32}, "sim": {"max_steps": 6}, "scenes": {"train_scenes": 3}})
OPEN = Scene("open", "grass", Start(0.3125, 0.3125, 0.0), (2.1875, 0.3125), ())
BLOCKED = Scene("blocked", "grass", Start(0.3125, 0.3125, 0.0), (8.0, 8.0), (Obstacle("tree", 3.2, 0.3125, 1.0),))
CORNER = Scene("corner", "grass", Start(9.6875, 9.6875, 0.0), (-8.0, 8.0), ())


class Recorder:
    """Camera that draws nothing and records its calls."""

    config = CONFIG.camera

    def __init__(self):
        self.calls = []

    def render(self, scene, pose, roll_rad=0.0, pitch_rad=0.0, people=None):
        self.calls.append((scene, pose, roll_rad, pitch_rad, people))
        return np.full((32, 32, 3), len(self.calls) % 256, np.uint8)


@pytest.fixture
def camera():
    return Recorder()


@pytest.fixture
def env(camera):
    env = CarNavigation(config=CONFIG, camera=camera, render_mode="rgb_array")
    yield env
    env.close()


def test_passes_gymnasiums_checker_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make("zsdist/CarNavigation-v0", config=CONFIG, render_mode="rgb_array")
        check_env(env.unwrapped)
        env.close()


def test_observation_has_the_cameras_image_the_true_pose_and_the_goal(env):
    observation, info = env.reset(options={"scene": OPEN})
    assert observation["image"].shape == (32, 32, 3)
    assert observation["pose"] == pytest.approx([0.3125, 0.3125, 0.0], abs=0.01)
    assert observation["goal"].tolist() == [2.1875, 0.3125]
    assert set(info) == {"scene", "action_mask", "sim_steps"}
    assert info["scene"] == "open"


def test_the_camera_draws_from_the_true_pose_roll_and_pitch(env, camera):
    env.reset(options={"scene": OPEN})
    observation = env.step(Action.FORWARD)[0]
    scene, pose, roll_rad, pitch_rad, people = camera.calls[-1]
    assert scene is OPEN
    assert tuple(pose) == tuple(observation["pose"])
    assert (roll_rad, pitch_rad) == env.world.tilt
    assert 0 < abs(pitch_rad) < math.radians(5)
    assert people.shape == (0, 2)
    assert (env.render() == observation["image"]).all()


def test_without_images_the_camera_draws_only_requested_pictures_and_once_per_step(camera):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        blind = CarNavigation(config=CONFIG, camera=camera, render_mode="rgb_array", images=False)
        check_env(blind, skip_render_check=True)
    calls = camera.calls
    calls.clear()
    assert set(blind.reset(options={"scene": OPEN})[0]) == set(blind.step(Action.FORWARD)[0]) == {"pose", "goal"}
    assert calls == []
    picture = blind.picture()
    assert (blind.picture() == picture).all() and (blind.render() == picture).all()
    assert len(calls) == 1 and tuple(calls[0][1]) == tuple(blind.world.pose) and calls[0][2:4] == blind.world.tilt
    blind.step(Action.FORWARD)
    assert not (blind.picture() == picture).all()
    blind.close()


def test_a_picture_from_another_pose_is_that_of_a_level_car_and_does_not_replace_the_true_one(env, camera):
    observation = env.reset(options={"scene": OPEN})[0]
    there = Pose(1.0, 2.0, 0.5)
    env.picture(there)
    assert camera.calls[-1][1:4] == (there, 0.0, 0.0)
    assert (env.picture() == observation["image"]).all()


def test_reaching_the_goal_terminates_with_the_papers_reward(env):
    env.reset(options={"scene": OPEN})
    rewards = []
    for _ in range(3):
        observation, reward, terminated, truncated, info = env.step(Action.FORWARD)
        rewards.append(reward)
        if terminated:
            break
    away = math.dist(observation["pose"][:2], (2.1875, 0.3125))
    assert away <= 0.60
    assert (terminated, truncated, info["success"], info["collision"]) == (True, False, True, False)
    assert info["reward_terms"] == {"distance": -away, "safety": 0.0, "goal": 1000.0}
    assert rewards[-1] == pytest.approx(1000.0 - away)
    assert rewards[0] == pytest.approx(-1.25, abs=0.1)


def test_a_collision_terminates_with_its_penalty(env):
    env.reset(options={"scene": BLOCKED})
    for _ in range(5):
        *_, terminated, truncated, info = env.step(Action.FORWARD)
        if terminated:
            break
    assert (terminated, truncated, info["success"], info["collision"]) == (True, False, False, True)
    assert info["reward_terms"]["safety"] == -200.0


def test_the_step_limit_truncates(env):
    env.reset(options={"scene": BLOCKED})
    ends = [env.step(Action.TURN_LEFT_90)[2:4] for _ in range(6)]
    assert ends == [(False, False)] * 5 + [(False, True)]
    with pytest.raises(ResetNeeded, match="call reset"):
        env.step(Action.FORWARD)


def test_the_mask_forbids_moves_off_the_grid_only(env):
    info = env.reset(options={"scene": CORNER})[1]
    assert info["action_mask"].tolist() == [False, False, False, True, True]  # facing east, in the north-eastern corner
    assert env.reset(options={"scene": BLOCKED})[1]["action_mask"].all()


def test_the_seed_chooses_the_scene_and_training_scenes_only(env):
    first, info = env.reset(seed=5)
    again, info_again = env.reset(seed=5)
    assert info["scene"] == info_again["scene"]
    assert (first["pose"] == again["pose"]).all()
    assert len({env.reset()[1]["scene"] for _ in range(20)}) == 3  # of `train_scenes`


def test_every_family_gives_episodes():
    for family in FAMILIES:
        env = CarNavigation(family, CONFIG, Recorder())
        assert env.reset(seed=1)[1]["scene"].startswith(family)
        env.close()


def test_wrong_calls_are_refused_with_a_clear_message(env):
    with pytest.raises(ResetNeeded, match="call reset"):
        env.step(Action.FORWARD)
    with pytest.raises(ResetNeeded, match="call reset"):
        env.render()
    with pytest.raises(ResetNeeded, match="call reset"):
        env.picture()
    env.reset(options={"scene": OPEN})
    with pytest.raises(InvalidAction, match=r"action is 5; allowed are the integers 0 to 4"):
        env.step(5)
    with pytest.raises(ConfigError, match="scene family is 'urban'; allowed are singleton, iid"):
        CarNavigation("urban")


def test_default_configuration_renders_at_the_encoders_size():
    env = CarNavigation(config=Config(), camera=Recorder())
    assert env.observation_space["image"].shape == (224, 224, 3)
    assert env.render() is None
    env.close()
