import math
from dataclasses import replace

import numpy as np
import pytest

from zsdist.config import CameraConfig
from zsdist.datasets.degradation import degrade
from zsdist.sim.camera import make_camera
from zsdist.sim.camera.appearance import of_scene, varied
from zsdist.sim.camera.optics import mount
from zsdist.sim.camera.primitives import ARENA_HALF_M, primitives_of
from zsdist.sim.camera.shadows import shadow_corners, sunshine
from zsdist.sim.physics.raycast import ray_distances
from zsdist.sim.scenes.kinds import KINDS, SEGMENT_GROUND, SEGMENT_SKY, SEGMENT_WALL
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Pose

SIZE = 96
CAMERA = CameraConfig(size_px=SIZE)


def scene(*obstacles, ground="sand"):
    return Scene("test", ground, Start(-8.0, -8.0, 0.0), (8.0, 8.0), obstacles)


EVERY_KIND = scene(
    Obstacle("tree", 2.0, 3.0, 1.0), Obstacle("sand_pile", 3.0, -2.0, 1.2), Obstacle("rock", 5.0, 0.5, 0.8),
    Obstacle("bush", 6.0, 4.0, 1.0), Obstacle("pole", 1.0, -0.5, 0.15), Obstacle("person", 2.5, 0.8, 0.3),
    Obstacle("box", 7.0, -5.0, None, (4.0, 0.6, 2.0), 30.0), Obstacle("car", -1.0, -5.0, None, (4.2, 1.8, 1.5), 60.0),
)  # fmt: skip
POSES = [Pose(-3.0, 0.0, 0.0), Pose(-4.0, -4.0, 0.7), Pose(9.0, 8.0, -2.4), Pose(4.0, -7.0, 2.2)]


@pytest.mark.parametrize("back_end", ["caster", "pybullet"])
def test_a_pole_dead_ahead_is_in_the_middle_at_its_true_depth(back_end):
    camera = make_camera(CameraConfig(size_px=SIZE, back_end=back_end))
    world = scene(Obstacle("pole", 4.0, 0.0, 0.15))
    _, depth, segments = camera.render_labelled(world, Pose(0.0, 0.0, 0.0))
    middle = segments[SIZE // 2] == KINDS["pole"].segment_id
    assert np.flatnonzero(middle).mean() == pytest.approx((SIZE - 1) / 2, abs=0.6)
    assert depth[SIZE // 2, SIZE // 2] == pytest.approx(4.0 - 0.15 - CAMERA.forward_m, abs=0.005)


def test_an_obstacle_on_the_left_is_drawn_on_the_left():
    _, _, segments = make_camera(CAMERA).render_labelled(scene(Obstacle("rock", 4.0, 2.0, 0.8)), Pose(0.0, 0.0, 0.0))
    columns = np.flatnonzero((segments == KINDS["rock"].segment_id).any(0))
    assert len(columns) and columns.max() < SIZE / 2


def test_sky_is_above_ground_below_and_walls_between():
    _, depth, segments = make_camera(CAMERA).render_labelled(scene(), Pose(0.0, 0.0, 0.3))
    assert (segments[0] == SEGMENT_SKY).all() and np.isinf(depth[0]).all()
    assert (segments[-1] == SEGMENT_GROUND).all()
    assert (segments[SIZE // 2 - 1] == SEGMENT_WALL).all()
    assert not np.isnan(depth).any()


def test_the_nearer_of_two_obstacles_hides_the_other():
    near, far = Obstacle("tree", 4.0, 0.0, 1.0), Obstacle("person", 7.0, 0.0, 0.3)
    camera = make_camera(CAMERA)
    for world in (scene(near, far), scene(far, near)):
        _, _, segments = camera.render_labelled(world, Pose(0.0, 0.0, 0.0))
        assert (segments == KINDS["tree"].segment_id).any()
        assert not (segments == KINDS["person"].segment_id).any()


@pytest.mark.parametrize("pose", POSES)
def test_depth_at_camera_height_is_the_planar_ray_distance(pose):
    angles = np.arctan(1.0 - 2.0 * (np.arange(SIZE) + 0.5) / SIZE)
    x, y = pose.x_m + math.cos(pose.heading_rad), pose.y_m + math.sin(pose.heading_rad)
    tall = scene(*(o for o in EVERY_KIND.obstacles if o.kind in ("tree", "pole", "person", "box")))
    _, depth, _ = make_camera(CAMERA).render_labelled(tall, pose)
    distance, _ = ray_distances(tall.circles(), tall.boxes(), ARENA_HALF_M, x, y, pose.heading_rad + angles, 40.0)
    assert depth[SIZE // 2] / np.cos(angles) == pytest.approx(distance, abs=0.01)


@pytest.mark.parametrize("pose", POSES)
def test_the_two_back_ends_see_the_same(pose):
    tiny = make_camera(CameraConfig(size_px=SIZE, back_end="pybullet"))
    ours, theirs = (camera.render_labelled(EVERY_KIND, pose, 0.03, -0.04) for camera in (make_camera(CAMERA), tiny))
    same = ours[2] == theirs[2]
    seen = same & np.isfinite(ours[1]) & np.isfinite(theirs[1])
    assert same.mean() > 0.99
    assert np.mean(np.abs(ours[1][seen] - theirs[1][seen]) < 0.02) > 0.99


@pytest.mark.parametrize("back_end", ["caster", "pybullet"])
def test_people_are_drawn_at_the_given_positions(back_end):
    camera = make_camera(CameraConfig(size_px=SIZE, back_end=back_end))
    walker = Obstacle("person", 4.0, 2.0, 0.3, path=((4.0, 2.0), (4.0, -2.0)), speed_mps=1.0)
    world = scene(Obstacle("rock", 6.0, 3.0, 0.5), walker)
    places = []
    for people in (None, np.array([[4.0, -2.0]])):
        _, _, segments = camera.render_labelled(world, Pose(0.0, 0.0, 0.0), people=people)
        places.append(np.flatnonzero((segments == KINDS["person"].segment_id).any(0)).mean())
    assert places[0] < SIZE / 2 < places[1]
    assert places[0] + places[1] == pytest.approx(SIZE - 1, abs=1.1)


def test_the_same_scene_looks_the_same_from_any_camera():
    first = make_camera(CAMERA).render(EVERY_KIND, POSES[0])
    again = Scene(**vars(EVERY_KIND))
    assert again is not EVERY_KIND
    assert (make_camera(CAMERA).render(again, POSES[0]) == first).all()


def test_a_camera_keeps_scenes_apart():
    camera = make_camera(CAMERA)
    worlds = [scene(Obstacle("rock", 4.0, float(k), 0.8)) for k in range(3)]
    first = [camera.render(world, POSES[0]) for world in worlds]
    assert all((camera.render(world, POSES[0]) == image).all() for world, image in zip(worlds, first, strict=True))
    assert (first[0] != first[1]).any()


def test_grounds_differ_in_colour():
    camera = make_camera(CAMERA)
    means = [camera.render(scene(ground=g), POSES[0])[-20:].mean((0, 1)) for g in ("sand", "grass", "asphalt")]
    assert means[0][0] > means[2][0] + 20  # sand is brighter than asphalt
    assert means[1][1] > means[1][0] + 10  # grass is green


def test_varied_appearances_differ_and_follow_their_seed():
    primitives = primitives_of(EVERY_KIND)
    looks = [varied(EVERY_KIND, primitives, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    assert (looks[0].materials == looks[1].materials).all() and (looks[0].ground == looks[1].ground).all()
    assert (looks[0].materials != looks[2].materials).any() and (looks[0].ground != looks[2].ground).any()
    assert (of_scene(EVERY_KIND, primitives).ground != looks[0].ground).any()


def test_light_on_the_ground_is_interpolated_between_the_cells_of_the_shadow_map():
    light = np.ones((8, 8), np.float32)
    light[3, 4] = 0.6  # the 1 m cell whose middle is 0.5 m east and 0.5 m south of the origin
    x, y = np.array([0.5, 0.75, 1.5, 0.5, -0.5], np.float32), np.array([-0.5, -0.5, -0.5, 0.25, -0.5], np.float32)
    lit = np.empty(5, np.float32)
    sunshine(shadow_corners(light), 4.0, x, y, np.empty(5, np.uint32), lit)
    assert lit == pytest.approx([0.6, 0.7, 1.0, 0.9, 1.0], abs=0.003)


def test_nose_down_lowers_the_line_of_sight():
    level, _ = mount(Pose(0.0, 0.0, 0.0), 1.0, 1.0)
    lowered, axes = mount(Pose(0.0, 0.0, 0.0), 1.0, 1.0, pitch_rad=0.1)
    assert level == pytest.approx([1.0, 0.0, 1.0])
    assert axes[0][2] < 0 and lowered[2] < level[2]
    assert axes @ axes.T == pytest.approx(np.eye(3))


@pytest.mark.parametrize("size_px", [96, 101])
def test_in_a_row_with_sky_and_ground_neither_is_drawn_over_the_other(size_px):
    def rolled(zenith, ground):
        def look(scene, primitives):
            its = of_scene(scene, primitives)
            return replace(its, sky=np.array([*its.sky[:3], *[zenith] * 3, 0.0]), ground=ground * its.ground)

        camera = make_camera(CameraConfig(size_px=size_px, height_m=5.0), look)  # sees over the walls
        picture, _, segments = camera.render_labelled(scene(), Pose(0.0, 0.0, 0.0), roll_rad=0.6)
        return picture, segments == SEGMENT_SKY, segments == SEGMENT_GROUND

    picture, sky, ground = rolled(0.0, np.ones(19))
    assert (sky.any(1) & ground.any(1)).sum() > size_px / 4
    assert (rolled(1.0, np.ones(19))[0][ground] == picture[ground]).all()
    assert (rolled(0.0, np.repeat([0.5, 1.0], (6, 13)))[0][sky] == picture[sky]).all()


def test_positive_roll_puts_the_right_side_down():
    _, axes = mount(Pose(0.0, 0.0, 0.5), 1.0, 1.0, roll_rad=0.1)
    assert axes[1][2] > 0  # the left axis points up


def test_degradation_keeps_shape_and_type_and_follows_its_seed():
    image = make_camera(CAMERA).render(EVERY_KIND, POSES[0])
    for seed in range(5):
        once, twice = (degrade(image, np.random.default_rng(seed)) for _ in range(2))
        assert once.shape == image.shape and once.dtype == np.uint8
        assert (once == twice).all()
    assert any((degrade(image, np.random.default_rng(seed)) != image).any() for seed in range(5))
