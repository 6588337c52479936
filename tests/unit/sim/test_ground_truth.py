import math

import numpy as np
import pytest

from zsdist.config import CameraConfig
from zsdist.sim.camera import make_camera
from zsdist.sim.camera.primitives import ARENA_HALF_M
from zsdist.sim.ground_truth import rays_met
from zsdist.sim.scenes.kinds import KINDS, SEGMENT_GROUND, SEGMENT_SKY, SEGMENT_WALL
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Pose

CAMERA = CameraConfig(size_px=64)
HERE = Pose(0.0, 0.0, 0.0)
AHEAD_LEFT_RIGHT = np.array([0.0, math.pi / 4, -math.pi / 4])
WALL, FREE = -2, -1


def scene(*obstacles):
    return Scene("test", "grass", Start(-8.0, -8.0, 0.0), (4.0, 3.0), obstacles)


def test_rays_meet_the_nearest_obstacle_and_tell_its_number_kind_and_motion():
    tree, person, hidden = Obstacle("tree", 4.0, 4.0, 1.0), Obstacle("person", 4.0, 0.0, 0.3), Obstacle("rock", 6, 0, 1)
    met = rays_met(scene(tree, person, hidden), HERE, CAMERA, AHEAD_LEFT_RIGHT)
    ahead_m = 4.0 - 0.3 - CAMERA.forward_m
    assert met.distance_m[0] == pytest.approx(ahead_m, abs=1e-6) and met.distance_m[2] == CAMERA.range_m
    assert met.obstacle.tolist() == [1, 0, FREE]
    assert met.dynamic.tolist() == [True, False, False]
    assert met.segment.tolist() == [KINDS["person"].segment_id, KINDS["tree"].segment_id, 0]
    assert met.obstacle.dtype == np.int64 and met.dynamic.dtype == bool and met.segment.dtype == np.uint8


def test_round_obstacles_are_numbered_before_boxes():
    box, tree = Obstacle("box", 4.0, 0.0, None, (1.0, 1.0, 2.0), 0.0), Obstacle("tree", 3.0, 3.0, 1.0)
    met = rays_met(scene(box, tree), HERE, CAMERA, AHEAD_LEFT_RIGHT)
    assert met.obstacle.tolist() == [1, 0, FREE]
    assert met.segment.tolist() == [KINDS["box"].segment_id, KINDS["tree"].segment_id, 0]


def test_rays_start_at_the_camera_and_turn_with_the_car():
    met = rays_met(scene(Obstacle("pole", 0.0, 3.0, 0.2)), Pose(0.0, 0.0, math.pi / 2), CAMERA, np.zeros(1))
    assert met.distance_m[0] == pytest.approx(3.0 - 0.2 - CAMERA.forward_m, abs=1e-6)


def test_the_wall_of_the_arena_is_met_and_does_not_move():
    met = rays_met(scene(), Pose(ARENA_HALF_M - 2.0, 0.0, 0.0), CAMERA, np.zeros(1))
    assert met.distance_m[0] == pytest.approx(2.0 - CAMERA.forward_m, abs=1e-6)
    assert (met.obstacle[0], met.dynamic[0], met.segment[0]) == (WALL, False, SEGMENT_WALL)


def test_people_are_met_where_they_walk_now():
    world = scene(Obstacle("person", 4.0, 0.0, 0.3, path=((4.0, 0.0), (4.0, 4.0)), speed_mps=1.0))
    ahead = rays_met(world, HERE, CAMERA, AHEAD_LEFT_RIGHT)
    aside = rays_met(world, HERE, CAMERA, AHEAD_LEFT_RIGHT, np.array([[CAMERA.forward_m + 3.0, 3.0]]))
    assert ahead.dynamic.tolist() == [True, False, False]
    assert aside.dynamic.tolist() == [False, True, False]


def test_rays_end_where_the_picture_has_obstacles_meet_the_ground():
    """The lowest obstacle pixel in each ray's column lies at the height that follows from the ray's distance."""
    config, rays = CameraConfig(size_px=256), 32
    angles = np.arctan(1 - 2 * (np.arange(rays) + 0.5) / rays)  # of equal pixel columns of a view of 90 degrees
    camera = make_camera(config)
    world = scene(Obstacle("pole", 3.0, 1.0, 0.3), Obstacle("box", 4.0, -1.0, None, (1.0, 2.0, 2.0), 20.0))
    distance_m = rays_met(world, HERE, config, angles).distance_m
    _, _, segments = camera.render_labelled(world, HERE)
    kinds = [KINDS[name].segment_id for name in ("pole", "box")]
    width = 256 // rays
    checked = 0
    for ray, angle in enumerate(angles):
        columns = segments[:, ray * width + width // 2 - 1 : ray * width + width // 2 + 1]
        seen = np.flatnonzero(np.isin(columns, kinds).any(1))
        assert bool(len(seen)) == (distance_m[ray] < config.range_m)
        if len(seen):
            depth = distance_m[ray] * math.cos(angle)
            assert seen.max() + 1 == pytest.approx(128 + 128 * config.height_m / depth, abs=3)
            checked += 1
        else:
            assert set(np.unique(columns[-20:])) <= {SEGMENT_GROUND, SEGMENT_SKY}
    assert checked >= 6
