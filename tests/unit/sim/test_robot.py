import math

import numpy as np
import pytest

from zsdist.planning.grid import Grid
from zsdist.sim.robot import CameraFaults, LatePictures, OdometryErrors, RobotWorld, SimulatedOdometry, jpeg, standing
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Pose

OPEN = Scene("open", "grass", Start(0.1, -0.2, 30.0), (8.0, 8.0), ())
WALLED = Scene("walled", "grass", Start(0.0, 0.0, 0.0), (8.0, 8.0), (Obstacle("tree", 3.0, 0.0, 1.0),))


@pytest.fixture
def world():
    made = RobotWorld(Grid())
    yield made
    made.close()


def drive(world, speed_mps, turn_rad_s, seconds):
    return [world.step(speed_mps, turn_rad_s) for _ in range(round(seconds / 0.05))]


def test_the_robot_stands_where_its_scene_says_also_off_the_lattice(world):
    world.begin(OPEN)
    assert world.pose == pytest.approx((0.1, -0.2, math.radians(30)), abs=0.01)
    drive(world, 0.0, 0.0, 1.0)
    assert standing(world.motion) and world.pose == pytest.approx((0.1, -0.2, math.radians(30)), abs=0.02)


@pytest.mark.parametrize("speed_mps", [0.3, 1.0, -0.5])
def test_it_drives_as_fast_as_it_is_commanded(world, speed_mps):
    world.begin(OPEN)
    drive(world, speed_mps, 0.0, 1.0)
    before = world.pose
    drive(world, speed_mps, 0.0, 1.0)
    assert math.dist(world.pose[:2], before[:2]) == pytest.approx(abs(speed_mps), rel=0.15)


@pytest.mark.parametrize("turn_rad_s", [0.5, -1.5])
def test_it_turns_about_as_fast_as_it_is_commanded_and_in_place(world, turn_rad_s):
    world.begin(OPEN)
    drive(world, 0.0, turn_rad_s, 0.5)
    before = world.pose
    drive(world, 0.0, turn_rad_s, 1.0)
    turned = math.remainder(world.pose.heading_rad - before.heading_rad, math.tau)
    assert turned == pytest.approx(turn_rad_s, rel=0.35) and math.dist(world.pose[:2], before[:2]) < 0.1


def test_it_brakes_within_half_a_second(world):
    world.begin(OPEN)
    drive(world, 1.0, 0.0, 1.0)
    drive(world, 0.0, 0.0, 0.5)
    assert standing(world.motion)


def test_a_contact_is_noticed(world):
    world.begin(WALLED)
    assert any(drive(world, 1.0, 0.0, 3.0)) and world.clearance_m < 0.05


def errors(**given):
    return SimulatedOdometry(Pose(1.0, 2.0, 0.2), OdometryErrors(**given), np.random.default_rng(3), 0.05)


def path(steps=400):
    return [Pose(1.0 + 0.05 * n, 2.0 + 0.01 * n, 0.2) for n in range(steps)]


def test_an_odometry_without_errors_is_the_truth():
    odometry = errors()
    assert all(odometry.read(pose) == pytest.approx(pose) for pose in path())


def test_errors_of_distance_grow_with_the_way_and_those_of_headings_do_not():
    scaled = errors(scale=0.01)
    found = [scaled.read(pose) for pose in path()]
    off = [math.dist(pose[:2], true[:2]) for pose, true in zip(found, path(), strict=True)]
    assert 0 < off[100] < off[-1] < 0.05 * math.dist(path()[0][:2], path()[-1][:2])
    wandering = errors(heading_rad=math.radians(1.0))
    headings = np.degrees([wandering.read(pose).heading_rad - pose.heading_rad for pose in path(20_000)])
    assert headings.std() == pytest.approx(1.0, rel=0.3) and np.abs(headings).max() < 5


def test_pictures_come_late_in_order_and_some_are_lost():
    line = LatePictures(CameraFaults(latency_s=0.1, loss=0.3), np.random.default_rng(0))
    picture, seen = np.zeros((4, 4, 3), np.uint8), []
    for number in range(1000):
        line.take(number / 10, picture)
        seen += [taken_s for taken_s, _ in line.arrived(number / 10)]
        assert not seen or seen[-1] <= number / 10 - 0.1 + 1e-9
    assert seen == sorted(seen) and len(seen) == pytest.approx(700, abs=60)


def test_the_exposure_changes_the_brightness():
    line = LatePictures(CameraFaults(exposure=0.5), np.random.default_rng(0))
    for number in range(70):
        line.take(number / 10, np.full((4, 4, 3), 100, np.uint8))
    means = [picture.mean() for _, picture in line.arrived(10.0)]
    assert min(means) == pytest.approx(50, abs=2) and max(means) == pytest.approx(150, abs=2)


def test_a_jpeg_is_close_to_its_picture():
    import cv2

    picture = np.zeros((32, 32, 3), np.uint8)
    picture[..., 0] = 200
    read = cv2.imdecode(jpeg(picture), cv2.IMREAD_COLOR)
    assert np.abs(read[..., ::-1].astype(int) - picture).max() < 12
