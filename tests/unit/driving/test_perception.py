import math

import numpy as np
import pytest
from fakes import FakeVisualAct, LatticeEnv

from zsdist.config import Config
from zsdist.driving.actor_car import ActorCar, EpisodeTask
from zsdist.driving.perception import Perception
from zsdist.planning.grid import Grid
from zsdist.sim.scenes import families
from zsdist.sim.scenes.scene import Obstacle, Scene
from zsdist.types import Level, Pose
from zsdist.vision.ray_ablation import ablate_rays
from zsdist.vision.reading_cache import SET_BYTES, ReadingCache

STILL = families.draw("iid", "train", 0)
PERSON = Obstacle("person", 8.0, 8.0, 0.3, path=((8.0, 8.0), (9.0, 8.0)), speed_mps=0.5)
STANDING = Obstacle("person", 8.0, 8.0, 0.3)


class Counted(FakeVisualAct):
    """Vision model that records the batch sizes of its readings."""

    def __init__(self):
        super().__init__()
        self.batches = []

    def read(self, images):
        self.batches.append(len(images))
        return super().read(images)


@pytest.fixture
def visual_act(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return Counted()


def perception(visual_act, cached=True, vision="vision", rays="all"):
    cache = ReadingCache(100 * SET_BYTES, vision) if cached else None
    return Perception(visual_act, Grid(), rays, cache)


class MovedEnv(LatticeEnv):
    """Environment that places the car off the lattice by metres and radians, and records the poses of pictures."""

    def __init__(self, moved, goal):
        super().__init__()
        self.asked, self._moved, self._goal = [], moved, goal

    def reset(self, **options):
        observation, info = super().reset(**options)
        self._pose = Pose(*(observation["pose"] + self._moved))
        goal = observation["goal"] if self._goal is None else np.array(self._goal)
        return observation | {"pose": np.array(self._pose), "goal": goal}, info

    def picture(self, pose=None):
        self.asked.append(pose)
        return super().picture(pose or self._pose)


def car(scene=STILL, moved=(0.0, 0.0, 0.0), goal=None, **task):
    """Return a car at the start of an episode in `scene`."""
    car = ActorCar(MovedEnv(moved, goal), Config())
    car.begin(EpisodeTask(scene, 1, 0.5, True, (1,), **task), dict.fromkeys(Level, 0))
    return car


def with_obstacle(obstacle):
    return Scene("scene", STILL.ground, STILL.start, STILL.goal, (*STILL.obstacles, obstacle))


def test_a_picture_is_rendered_and_read_once_for_all_cars_and_episodes(visual_act):
    first, again, other = car(), car(), car(with_obstacle(STANDING))
    sees = perception(visual_act)
    fresh = sees.views([first, other])
    known = sees.views([other, again])
    assert visual_act.batches == [1, 1]  # one picture at a time
    assert len(first.env.asked) == len(other.env.asked) == 1 and again.env.asked == []
    assert sees.statistics() == {"cache_hits": 2, "cache_misses": 2, "cache_bypasses": 0}
    for one, two in zip(fresh, reversed(known), strict=True):
        np.testing.assert_array_equal(one.ray_probabilities, two.ray_probabilities)
        np.testing.assert_array_equal(one.advice, two.advice)


def test_another_actor_of_the_machine_finds_remembered_readings(visual_act):
    one, other = perception(visual_act), perception(visual_act)
    one.views([car()])
    other.views([car()])
    assert visual_act.batches == [1] and other.hits == 1


def test_a_view_does_not_depend_on_earlier_readings(visual_act):
    near = (0.06, -0.05, math.radians(3))
    before = perception(visual_act).views([car(moved=near)])
    sees = perception(visual_act, vision="as if nobody had looked")
    sees.views([car(moved=(-0.05, 0.02, -0.05))])
    (after,) = sees.views([car(moved=near)])
    np.testing.assert_array_equal(before[0].ray_probabilities, after.ray_probabilities)
    np.testing.assert_array_equal(before[0].advice, after.advice)


def test_the_advice_is_for_the_goal_at_hand(visual_act):
    sees = perception(visual_act)
    there, elsewhere = car(), car(goal=(-STILL.goal[0], -STILL.goal[1]))
    (one,), (other,) = sees.views([there]), sees.views([elsewhere])
    assert sees.hits == 1
    np.testing.assert_array_equal(one.clearance_m, other.clearance_m)
    assert np.abs(one.advice - other.advice).max() > 0.1


@pytest.mark.parametrize(
    "made",
    [
        lambda: car(candidate="recent"),
        lambda: car(with_obstacle(PERSON)),
        lambda: car(moved=(0.08, 0.08, 0.0)),
        lambda: car(moved=(0.0, 0.0, math.radians(-5.5))),
    ],
    ids=["evaluation drive", "somebody walks", "aside of the lattice", "turned off the lattice"],
)
def test_the_memory_is_bypassed_where_it_must_not_be_used(visual_act, made):
    sees = perception(visual_act)
    for _ in range(2):
        looking = made()
        sees.views([looking])
        assert looking.env.asked == [None]  # at the true pose
    assert visual_act.batches == [1, 1]
    assert sees.hits == sees.misses == 0
    assert sees.bypasses == (2 if looking.trains else 0)
    sees.views([car()])
    assert sees.misses == 1  # nothing had been cached


def test_a_drive_of_a_candidate_does_not_use_readings_of_a_training_episode(visual_act):
    sees = perception(visual_act)
    sees.views([car()])
    drive = car(candidate="recent")
    sees.views([drive])
    assert drive.env.asked == [None] and visual_act.batches == [1, 1] and sees.hits == 0


def test_without_a_cache_every_picture_is_taken_at_the_true_pose_and_nothing_is_counted(visual_act):
    sees = perception(visual_act, cached=False)
    looking = car()
    sees.views([looking])
    sees.views([looking])
    assert looking.env.asked == [None, None] and visual_act.batches == [1, 1]
    assert sees.statistics() == {}
    sees.close()


@pytest.mark.parametrize("rays", ["three", "none"])
def test_cars_see_no_more_than_the_ablation_lets_through(visual_act, rays):
    (whole,), (view,) = (perception(visual_act, rays=share).views([car()]) for share in ("all", rays))
    np.testing.assert_array_equal(view.ray_probabilities, ablate_rays(whole, rays).ray_probabilities)
    np.testing.assert_array_equal(view.advice, ablate_rays(whole, rays).advice)
