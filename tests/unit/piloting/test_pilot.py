import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zsdist.piloting.limits import LONGEST_STEP_S, STANDSTILL, MotionLimits
from zsdist.piloting.pilot import Pilot
from zsdist.types import Pose

LIMITS = MotionLimits()
ANY = st.floats(allow_nan=True, allow_infinity=True)


def moved(pose, velocity, step_s):
    """Pose of an ideal robot after a step."""
    middle = pose.heading_rad + velocity.turn_rad_s * step_s / 2
    return Pose(
        pose.x_m + velocity.speed_mps * step_s * math.cos(middle),
        pose.y_m + velocity.speed_mps * step_s * math.sin(middle),
        pose.heading_rad + velocity.turn_rad_s * step_s,
    )


def follow(pilot, pose, step_s=0.1, late=0, most_s=40.0):
    """Follow with an ideal robot that obeys `late` steps later; return its last pose and the time."""
    line = [STANDSTILL] * late
    for step in range(int(most_s / step_s)):
        line.append(pilot.follow(pose, step_s))
        if pilot.done and line[-1] == STANDSTILL:
            return pose, step * step_s
        pose = moved(pose, line.pop(0), step_s)
    return pose, math.inf


@pytest.mark.parametrize("late", [0, 1, 2])
@pytest.mark.parametrize("heading", [0.0, math.pi / 4, math.pi, -3 * math.pi / 4])
@pytest.mark.parametrize("turn", [0.0, math.pi / 4, -math.pi / 4])
def test_an_advance_ends_at_its_target(heading, turn, late):
    end = heading + turn
    target = Pose(3.0 + 0.625 * math.cos(end), 1.0 + 0.625 * math.sin(end), math.remainder(end, math.tau))
    pose, took_s = follow(Pilot(target, True, LIMITS), Pose(3.03, 0.96, heading + 0.05), late=late)
    assert math.dist(pose[:2], target[:2]) < 0.08
    assert abs(math.remainder(pose.heading_rad - target.heading_rad, math.tau)) < math.radians(5)
    assert took_s < 6.0


@pytest.mark.parametrize("turn", [math.pi / 2, -math.pi / 2, math.pi])
def test_a_turn_in_place_keeps_its_place(turn):
    target = Pose(0.0, 0.0, turn)
    pose, took_s = follow(Pilot(target, False, LIMITS), Pose(0.05, 0.0, 0.0), late=1)
    assert math.dist(pose[:2], (0.05, 0.0)) < 1e-9 and took_s < 6.0
    assert abs(math.remainder(pose.heading_rad - turn, math.tau)) < math.radians(5)


def test_a_target_elsewhere_is_reached_straight():
    target = Pose(0.3, 0.3, 0.0)
    pose, _ = follow(Pilot(target, True, LIMITS, along_target=False), Pose(0.0, 0.0, 2.0))
    assert math.dist(pose[:2], target[:2]) < 0.05 and abs(math.remainder(pose.heading_rad, math.tau)) < math.radians(5)


def test_a_robot_pushed_far_aside_turns_towards_its_target_again():
    pilot = Pilot(Pose(0.625, 0.0, 0.0), True, LIMITS)
    pose = Pose(0.0, 0.0, 0.0)
    for _ in range(5):
        pose = moved(pose, pilot.follow(pose, 0.1), 0.1)
    pose, took_s = follow(pilot, pose._replace(heading_rad=2.0))
    assert math.dist(pose[:2], (0.625, 0.0)) < 0.1 and took_s < 10.0


def test_after_a_halt_the_velocity_begins_at_zero():
    pilot = Pilot(Pose(5.0, 0.0, 0.0), True, LIMITS)
    pose = Pose(0.0, 0.0, 0.0)
    for _ in range(10):
        pilot.follow(pose, 0.1)
    pilot.halt()
    assert pilot.follow(pose, 0.1).speed_mps <= LIMITS.acceleration_mps2 * 0.1 + 1e-12


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_no_pose_leads_to_a_velocity_beyond_a_limit(data):
    target = Pose(*(data.draw(st.floats(-20, 20)) for _ in range(3)))
    pilot = Pilot(target, data.draw(st.booleans()), LIMITS, along_target=data.draw(st.booleans()))
    before = STANDSTILL
    for _ in range(data.draw(st.integers(1, 10))):
        pose = Pose(*(data.draw(st.one_of(st.floats(-20, 20), ANY)) for _ in range(3)))
        velocity = pilot.follow(pose, data.draw(ANY))
        check(velocity, before, LONGEST_STEP_S)
        before = velocity


def test_a_robot_that_obeys_badly_is_never_commanded_beyond_a_limit():
    """Each step is checked; benchmarks/robot.py takes a million of them."""
    rng = np.random.default_rng(5)
    for _ in range(40):
        pilot, pose = Pilot(Pose(*rng.normal(0, 1, 3)), bool(rng.random() < 0.7), LIMITS), Pose(0.0, 0.0, 0.0)
        before = STANDSTILL
        for _ in range(60):
            step_s = float(rng.choice([0.0, 0.05, 0.1, 0.3, 5.0]))
            velocity = pilot.follow(pose, step_s)
            check(velocity, before, step_s)
            before = velocity
            slip = type(velocity)(velocity.speed_mps * rng.normal(1, 0.5), velocity.turn_rad_s * rng.normal(1, 0.5))
            pose = Pose(*(moved(pose, slip, 0.1) + rng.normal(0, 0.02, 3)))


def check(velocity, before, step_s):
    step_s = min(step_s, LONGEST_STEP_S)
    assert 0.0 <= velocity.speed_mps <= LIMITS.speed_mps and abs(velocity.turn_rad_s) <= LIMITS.turn_rad_s
    assert abs(velocity.speed_mps - before.speed_mps) <= LIMITS.acceleration_mps2 * step_s + 1e-9
    assert abs(velocity.turn_rad_s - before.turn_rad_s) <= LIMITS.turn_acceleration_rad_s2 * step_s + 1e-9
