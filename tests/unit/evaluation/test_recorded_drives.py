import time

import numpy as np
import pytest
from fakes import FakeVisualAct, LatticeEnv
from recordings import SIMULATION, manifest_of, record, recorded

from zsdist import config
from zsdist.common import random_streams
from zsdist.driving.settings import recorder_settings
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.drivers import LearnedDriver, Observability
from zsdist.evaluation.episodes import EpisodeRunner
from zsdist.evaluation.oracle_view import by_camera
from zsdist.evaluation.recorded_drives import RecordedDrive, RecordingJob, record_each
from zsdist.evaluation.workers import Simulation, make_runner
from zsdist.recording import log, messages
from zsdist.recording.episode import read_episode
from zsdist.replay.buffer import RingBuffer
from zsdist.roles.shapes import SHAPES, initial_weights
from zsdist.sim.scenes import families
from zsdist.types import Level

SETTINGS = config.load(overrides=("sim.max_steps=40",))


@pytest.mark.parametrize("baseline", ["astar-vision", "random", "astar"])
def test_a_recorded_episode_is_the_one_that_an_evaluation_drives(tmp_path, baseline):
    records = record(tmp_path, 2, baseline=baseline)
    runner = make_runner(Contender(SETTINGS, baseline=baseline), SIMULATION)
    for number, found in enumerate(records):
        scene = families.draw("singleton", "test", number)
        driven = runner.drive(scene, random_streams.evaluated_episode(0, number))
        assert (found.poses, found.outcome) == (driven.poses, driven.outcome)


def test_a_file_holds_every_step_with_its_picture_pose_reward_and_map(tmp_path):
    made = recorded(tmp_path, 2)
    for number, path in made.episodes().items():
        read, scene = read_episode(path), families.draw("singleton", "test", number)
        env = LatticeEnv(config=SETTINGS)
        observation, _ = env.reset(options={"scene": scene})
        for step, action in enumerate(read.actions):
            assert np.array_equal(read.pictures[step], observation["image"])
            assert read.poses[step] == pytest.approx(observation["pose"])
            observation, reward, terminated, truncated, _ = env.step(int(action))
            assert read.rewards[step].sum() == pytest.approx(reward)
            assert (read.terminated[step], read.truncated[step]) == (terminated, truncated)
        assert np.array_equal(read.pictures[-1], observation["image"])
        assert read.goal == scene.goal and read.result["steps"] == len(read.actions)
        assert (read.terminated | read.truncated).sum() == 1
        maps = list(log.read(path, (messages.BELIEF,)))
        assert len(maps) == len(read.actions)
        assert (maps[-1].decoded().data != -1).sum() > (maps[0].decoded().data != -1).sum()


def test_transitions_are_one_a_step_and_level_and_a_replay_takes_all(tmp_path):
    made = recorded(tmp_path, 3)
    steps = sum(len(read_episode(path).actions) for path in made.episodes().values())
    for level, shape in SHAPES.items():
        ring = RingBuffer(shape.state_size, shape.actions, 1000)
        counts = [ring.insert(part) for part in made.trajectories(level)]
        assert sum(stored for stored, _ in counts) == steps and not any(rejected for _, rejected in counts)


def test_a_recorder_changes_no_decision_of_the_networks():
    parameters = {level: initial_weights(SETTINGS, level) for level in Level}

    def drive(recording):
        driver = LearnedDriver(SETTINGS, parameters, by_camera(FakeVisualAct()))
        if recording:
            assert driver.record(recorder_settings(SETTINGS))
        runner = EpisodeRunner(LatticeEnv(config=SETTINGS), SETTINGS, driver, Observability.CAMERA, time.perf_counter)
        return runner.drive(families.draw("iid", "test", 1), np.random.default_rng(0)).poses

    assert drive(True) == drive(False)


def test_an_episode_that_fails_leaves_no_file(tmp_path):
    class FailingError(Exception):
        pass

    class Failing(LatticeEnv):
        def step(self, action):
            if self._steps == 5:
                raise FailingError
            return super().step(action)

    simulation = Simulation(make_env=lambda settings, **_: Failing(config=settings))
    contender = Contender(SETTINGS, baseline="random")
    job = RecordingJob(contender, manifest_of(contender), tmp_path, 0, simulation)
    with pytest.raises(FailingError):
        list(record_each(job, [RecordedDrive(0, families.draw("singleton", "test", 0))], 1))
    assert list(tmp_path.iterdir()) == []
