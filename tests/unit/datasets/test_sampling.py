import math

import numpy as np
import pytest

from zsdist.config import CameraConfig
from zsdist.datasets.sampling import (
    PLACE_HALF_M,
    POSES_PER_SCENE,
    drawn_scenes,
    free_pose,
    people_on_paths,
    varied_camera,
)
from zsdist.errors import SceneError
from zsdist.sim.camera import make_camera
from zsdist.sim.camera.primitives import ARENA_HALF_M
from zsdist.sim.ground_truth import rays_met
from zsdist.sim.physics.collision import touching
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Pose

CAMERA = CameraConfig(size_px=64)
ANGLES = np.linspace(math.pi / 4, -math.pi / 4, 32)
TREE_AND_BOX = Obstacle("tree", 0.0, 0.0, 1.0), Obstacle("box", 5.0, 5.0, None, (6.0, 0.4, 2.0), 30.0)


def scene(*obstacles):
    return Scene("test", "grass", Start(-8.0, -8.0, 0.0), (4.0, 3.0), obstacles)


def walker(*path):
    return Obstacle("person", *path[0], 0.3, path=path, speed_mps=1.0)


def test_families_take_turns_and_each_scene_gives_several_pictures():
    drawn = list(drawn_scenes(["street", "iid"], "vision", 2 * POSES_PER_SCENE + 3, np.random.default_rng(0)))
    assert [family for family, _, _ in drawn] == ["street", "iid", "street"]
    assert [number for _, _, number in drawn] == [POSES_PER_SCENE, POSES_PER_SCENE, 3]
    assert len({world.hash() for _, world, _ in drawn}) == 3


def test_a_scene_is_drawn_only_when_it_is_asked_for():
    rng, untouched = np.random.default_rng(0), np.random.default_rng(0)
    scenes = drawn_scenes(["iid"], "vision", 100, rng)
    assert rng.bit_generator.state == untouched.bit_generator.state
    next(scenes)
    untouched.integers(1_000_000)
    assert rng.bit_generator.state == untouched.bit_generator.state


def test_no_pictures_need_no_scenes_and_an_unknown_split_is_refused():
    assert list(drawn_scenes(["iid"], "vision", 0, np.random.default_rng(0))) == []
    with pytest.raises(SceneError, match="holiday"):
        next(drawn_scenes(["iid"], "holiday", 1, np.random.default_rng(0)))


def test_free_poses_touch_nothing_and_are_often_close_to_an_obstacle():
    world, rng = scene(*TREE_AND_BOX), np.random.default_rng(0)
    poses = [free_pose(world, rng) for _ in range(200)]
    assert not any(touching(p, world.circles(), world.boxes(), arena_m=2 * ARENA_HALF_M) for p in poses)
    assert all(max(abs(p.x_m), abs(p.y_m)) <= PLACE_HALF_M for p in poses)
    assert np.mean([rays_met(world, p, CAMERA, ANGLES).distance_m.min() < 4.0 for p in poses]) > 0.4


def test_free_poses_avoid_people_where_they_walk_now():
    world, people = scene(walker((4.0, 0.0), (4.0, 2.0))), np.array([[4.0, 2.0]])
    rng = np.random.default_rng(0)
    poses = [free_pose(world, rng, people) for _ in range(100)]
    assert not any(touching(p, world.circles(people), world.boxes(), arena_m=2 * ARENA_HALF_M) for p in poses)


def test_an_empty_scene_has_free_poses_too():
    pose = free_pose(scene(), np.random.default_rng(0))
    assert isinstance(pose, Pose) and -math.pi <= pose.heading_rad <= math.pi


def test_people_are_placed_on_the_segments_of_their_paths():
    world = scene(TREE_AND_BOX[0], walker((4.0, 0.0), (4.0, 2.0)), walker((1.0, 5.0), (3.0, 5.0)))
    rng = np.random.default_rng(0)
    places = np.array([people_on_paths(world, rng) for _ in range(50)])
    assert places.shape == (50, 2, 2)
    assert (places[:, 0, 0] == 4.0).all() and (places[:, 1, 1] == 5.0).all()
    along = places[:, 0, 1]
    assert 0.0 <= along.min() < 0.5 and 1.5 < along.max() <= 2.0


def test_a_scene_without_walkers_has_no_people():
    assert people_on_paths(scene(*TREE_AND_BOX), np.random.default_rng(0)) is None


def test_varied_cameras_differ_in_height_and_in_nothing_else_of_their_settings():
    rng = np.random.default_rng(0)
    heights = [varied_camera(CAMERA, rng).config.height_m for _ in range(20)]
    assert len(set(heights)) == 20 and max(abs(height - CAMERA.height_m) for height in heights) <= 0.15
    config = varied_camera(CAMERA, rng).config
    assert config.model_copy(update={"height_m": CAMERA.height_m}) == CAMERA


def test_a_natural_camera_shows_a_scene_as_the_drive_does_and_a_varied_one_does_not():
    world, pose = scene(*TREE_AND_BOX), Pose(-5.0, 0.0, 0.0)
    natural, varied = (varied_camera(CAMERA, np.random.default_rng(3), share) for share in (1.0, 0.0))
    plain = make_camera(natural.config).render(world, pose)
    assert (natural.render(world, pose) == plain).all()
    assert (varied.render(world, pose) != plain).any()
