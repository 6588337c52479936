import ast
from pathlib import Path

import numpy as np
import pytest
from fakes import FakeVisualAct, LatticeEnv

import zsdist
from zsdist import config
from zsdist.errors import RunError
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.workers import Simulation, make_runner
from zsdist.policy import DrivingPolicy
from zsdist.run import program
from zsdist.sim.scenes import families
from zsdist.types import Level
from zsdist.vision import rays

CONFIG = config.load(overrides=("sim.max_steps=30", "camera.size_px=64"))


@pytest.fixture(scope="module")
def contender():
    return Contender(CONFIG, {level: program.make_learner(CONFIG, level).parameters() for level in Level})


class Seeing(FakeVisualAct):
    """Vision model that finds the picture of `LatticeEnv` in the corner of one that is as large as the camera's."""

    def read(self, images):
        return super().read(images[:, :1, : rays.RAYS])


SIMULATION = Simulation(lambda config, **_: LatticeEnv(config=config), lambda config: Seeing())


def seen(observation):
    """Return an observation of `LatticeEnv` with a picture of the camera's size."""
    image = np.zeros((64, 64, 3), np.asarray(observation["image"]).dtype)
    image[:1, : rays.RAYS] = observation["image"]
    return observation | {"image": image}


def drive(policy, scene):
    env = LatticeEnv(config=CONFIG)
    observation, _ = env.reset(options={"scene": scene})
    policy.reset()
    actions, over = [], False
    while not over:
        actions.append(policy.act(seen(observation)))
        observation, _, terminated, truncated, _ = env.step(actions[-1])
        over = terminated or truncated
    return actions


def test_a_policy_drives_as_in_an_evaluation_episode_after_episode(contender):
    policy = DrivingPolicy(contender, SIMULATION)
    for index in (0, 1):
        scene, moments = families.draw("iid", "test", index), []
        make_runner(contender, SIMULATION).drive(scene, np.random.default_rng(0), moments.append)
        assert drive(policy, scene) == [moment.action for moment in moments[:-1]]


def test_the_observation_of_another_episode_is_refused(contender):
    policy = DrivingPolicy(contender, SIMULATION)
    scenes = [families.draw("iid", "test", index) for index in (0, 1)]
    first, other = (seen(LatticeEnv(config=CONFIG).reset(options={"scene": scene})[0]) for scene in scenes)
    policy.act(first)
    with pytest.raises(RunError, match=r"another episode has begun; call reset\(\)"):
        policy.act(other)
    policy.reset()
    assert policy.act(other) in range(5)


def test_a_picture_of_another_size_is_refused_with_the_configuration_to_use(contender):
    observation, _ = LatticeEnv(config=CONFIG).reset(options={"scene": families.draw("iid", "test", 0)})
    for image in (None, np.zeros((32, 32, 3), np.uint8)):
        with pytest.raises(RunError, match=r"allowed is \(64, 64, 3\): make the environment with config=policy.config"):
            DrivingPolicy(contender, SIMULATION).act(observation | {"image": image})


def test_a_baseline_is_loaded_if_it_needs_no_more_than_an_observation():
    policy = zsdist.load_policy("random")
    scene = families.draw("iid", "test", 0)
    policy.reset(seed=3)
    first = drive(policy, scene)
    policy.reset(seed=2)
    assert drive(policy, scene) != first
    with pytest.raises(RunError, match="observes the whole true map, which no observation has"):
        zsdist.load_policy("astar")


def test_the_package_has_no_other_names_by_chance():
    with pytest.raises(AttributeError, match="no attribute 'load_polcy'"):
        _ = zsdist.load_polcy


def test_editors_and_help_see_the_names_of_the_package():
    stub = ast.parse(Path(zsdist.__file__).with_suffix(".pyi").read_text())
    imported = {alias.name for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert imported | {"__version__"} == set(zsdist.__all__) <= set(dir(zsdist))
    assert all(hasattr(zsdist, name) for name in zsdist.__all__)
