import math

import pybullet
import pytest

from zsdist.planning.footprint import CAR_LENGTH_M, CAR_WIDTH_M
from zsdist.planning.grid import Grid
from zsdist.sim.physics import car as subject
from zsdist.sim.physics.car import CarBody
from zsdist.sim.physics.controller import Rates
from zsdist.sim.physics.world import World
from zsdist.sim.scenes.scene import Scene, Start
from zsdist.types import Action, Pose


@pytest.fixture
def client():
    client = pybullet.connect(pybullet.DIRECT)
    yield client
    pybullet.disconnect(client)


def test_the_planners_box_is_the_cars_outline():
    assert pytest.approx(2 * (subject.AXLES_M + subject.WHEEL_RADIUS_M)) == CAR_LENGTH_M
    assert pytest.approx(subject.TREAD_M + subject.WHEEL_WIDTH_M) == CAR_WIDTH_M
    assert subject.CABINET_M[0] < CAR_LENGTH_M
    assert subject.CABINET_M[1] < CAR_WIDTH_M


def test_table_1_has_its_wheels_tread_and_cabinet():
    assert (subject.WHEEL_RADIUS_M, subject.TREAD_M, subject.CABINET_M[:2]) == (0.5, 1.0, (2.0, 0.9))


def test_friction_and_inertia_reach_the_wheels_and_not_the_base(client):
    car = CarBody(client)
    for wheel in range(4):
        mass_kg, friction, inertia = pybullet.getDynamicsInfo(car.body, wheel, physicsClientId=client)[:3]
        assert (mass_kg, friction) == (subject.WHEEL_KG, subject.WHEEL_FRICTION)
        assert inertia[1] == subject.AXLE_INERTIA_KG_M2
    mass_kg, friction = pybullet.getDynamicsInfo(car.body, -1, physicsClientId=client)[:2]
    assert mass_kg == subject.CABINET_KG
    assert friction != subject.WHEEL_FRICTION


def test_a_placed_car_is_still_and_level_at_its_pose(client):
    car = CarBody(client)
    pose = Pose(-3.0, 2.0, 2.5)
    car.place(pose)
    motion = car.motion()
    assert motion.pose == pytest.approx(pose)
    assert (motion.speed_mps, motion.turn_rate_rad_s) == (0.0, 0.0)
    assert car.tilt() == pytest.approx((0.0, 0.0))


def test_motors_keep_the_last_command_until_the_car_is_placed(client):
    car = CarBody(client)
    for rates, speed in ((Rates(2.0, 1.0), 2.0), (Rates(2.0, 1.0), 2.0), (Rates(0.5, 1.0), 0.5)):
        car.command(rates)
        for _ in range(100):
            pybullet.stepSimulation(client)
        assert pybullet.getJointState(car.body, 0, client)[1] == pytest.approx(speed, abs=0.05)
    car.place(Pose(0.0, 0.0, 0.0))
    for _ in range(20):
        pybullet.stepSimulation(client)
    assert pybullet.getJointState(car.body, 0, client)[1] == pytest.approx(0.0, abs=0.01)


def test_an_advance_after_an_advance_takes_fewer_steps_than_one_from_rest():
    world = World(Grid())
    world.reset(Scene("empty", "sand", Start(0.3125, 0.3125, 0.0), (8.0, 8.0), ()))
    steps = [world.drive(Action.FORWARD).sim_steps for _ in range(4)]
    world.close()
    assert max(steps[1:]) < steps[0]


def test_the_car_drives_level_enough_for_its_camera():
    world = World(Grid())
    world.reset(Scene("empty", "sand", Start(0.3125, 0.3125, 0.0), (8.0, 8.0), ()))
    tilts = []
    for action in (Action.FORWARD, Action.FORWARD, Action.TURN_LEFT_90, Action.LEFT_45, Action.FORWARD):
        world.drive(action)
        tilts += world.tilt
    world.close()
    assert max(map(abs, tilts)) < math.radians(3.0)
