import math
from concurrent.futures import Future
from types import SimpleNamespace

import numpy as np
import pytest

from zsdist.piloting.journey import Glimpse, Journey, JourneyPhase, TimedPose, Track
from zsdist.piloting.limits import STANDSTILL, MotionLimits
from zsdist.planning.footprint import successor
from zsdist.planning.grid import Grid
from zsdist.types import Action, Pose

GRID, LIMITS = Grid(), MotionLimits()
PICTURE = np.zeros((8, 8, 3), np.uint8)
STEP_S = 0.05


class Car:
    """Ideal robot with a journey; its policy takes the given actions, then arrives."""

    def __init__(self, pose, actions, carries_out=True):
        self.pose, self.time_s, self.asked = pose, 50.0, []
        self._actions = list(actions)
        self.waiting = False
        self.futures = []
        self.journey = Journey(self.decide, GRID, LIMITS, carries_out=carries_out)

    def decide(self, picture, pose):
        self.asked.append(pose)
        future = Future()
        self.futures.append(future)
        if not self.waiting:
            future.set_result(self.next(pose))
        return future

    def next(self, pose):
        if not self._actions:
            return SimpleNamespace(action=None, target=None, arrived=True, no_way=None)
        action = self._actions.pop(0)
        if isinstance(action, str):
            return SimpleNamespace(action=Action.FORWARD, target=pose, arrived=False, no_way=action)
        target = GRID.pose(successor(GRID.lattice_state(pose), action))
        return SimpleNamespace(action=Action(action), target=target, arrived=False, no_way=None)

    def step(self, picture=True):
        self.time_s += STEP_S
        self.journey.see_pose(TimedPose(self.time_s, self.pose))
        glimpse = Glimpse(self.time_s - 0.02, lambda: PICTURE) if picture else None
        velocity = self.journey.control(self.time_s, glimpse)
        heading = self.pose.heading_rad + velocity.turn_rad_s * STEP_S
        way = velocity.speed_mps * STEP_S
        self.pose = Pose(self.pose.x_m + way * math.cos(heading), self.pose.y_m + way * math.sin(heading), heading)
        return velocity

    def run(self, most_s=120.0):
        end_s = self.time_s + most_s
        while not self.journey.over and self.time_s < end_s:
            self.step()
        return self.journey


START = GRID.pose(GRID.lattice_state(Pose(0.3, 0.3, 0.0)))


def test_actions_are_followed_one_after_another_to_the_goal():
    car = Car(START, [Action.FORWARD, Action.LEFT_45, Action.TURN_RIGHT_90])
    journey = car.run()
    assert (journey.phase, journey.actions, journey.reason) == (JourneyPhase.ARRIVED, 3, "the goal is reached")
    end = GRID.lattice_state(START)
    for action in (Action.FORWARD, Action.LEFT_45, Action.TURN_RIGHT_90):
        end = successor(end, action)
    assert math.dist(car.pose[:2], GRID.pose(end)[:2]) < 0.1
    assert journey.path_m == pytest.approx(0.625 * (1 + math.sqrt(2)), abs=0.1)


def test_it_looks_only_while_it_stands():
    car = Car(START, [Action.FORWARD])
    speeds = []
    while not car.journey.over:
        asked = len(car.asked)
        speeds.append(car.step())
        if len(car.asked) > asked:
            assert speeds[-2:] in ([STANDSTILL] * 2, [STANDSTILL, speeds[-1]]) and speeds[-2] == STANDSTILL


def test_it_stands_while_the_policy_decides():
    car = Car(START, [Action.FORWARD])
    car.waiting = True
    for _ in range(100):
        assert car.step() == STANDSTILL
    assert len(car.asked) == 1
    car.futures[0].set_result(car.next(car.asked[0]))
    assert any(car.step() != STANDSTILL for _ in range(5))


def test_without_a_new_picture_it_stands():
    car = Car(START, [Action.FORWARD])
    assert all(car.step(picture=False) == STANDSTILL for _ in range(100))
    assert car.asked == []


def test_a_picture_from_before_the_stop_is_not_looked_at():
    car = Car(START, [Action.FORWARD])
    car.step()
    early = car.time_s - 1.0
    for _ in range(60):
        car.time_s += STEP_S
        car.journey.see_pose(TimedPose(car.time_s, car.pose))
        car.journey.control(car.time_s, Glimpse(early, lambda: PICTURE))
    assert car.asked == []


def test_a_start_off_the_lattice_is_first_driven_onto_it():
    car = Car(Pose(START.x_m + 0.2, START.y_m - 0.15, 0.3), [])
    car.run()
    assert math.dist(car.asked[0][:2], START[:2]) < 0.1
    assert abs(car.asked[0].heading_rad) < math.radians(5)


def test_after_a_hold_it_goes_on_with_its_action_from_rest():
    car = Car(START, [Action.FORWARD])
    while car.step().speed_mps < 0.2:
        pass
    car.journey.hold()
    assert car.step().speed_mps <= LIMITS.acceleration_mps2 * STEP_S + 1e-9
    assert car.run().actions == 1


def test_a_way_that_is_blocked_for_a_while_is_taken_when_it_opens():
    car = Car(START, ["a person is in the way"] * 3 + [Action.FORWARD])
    assert car.run().phase is JourneyPhase.ARRIVED


def test_a_way_that_stays_blocked_ends_the_drive_with_the_reason():
    journey = Car(START, ["every action hits something"] * 99).run()
    assert (journey.phase, journey.reason) == (JourneyPhase.ENDED, "every action hits something")


def test_a_robot_that_does_not_follow_ends_the_drive():
    car = Car(START, [Action.FORWARD])
    for _ in range(3000):
        car.step()
        car.pose = START
    assert car.journey.phase is JourneyPhase.ENDED and "the robot does not follow" in car.journey.reason


def test_a_drive_that_is_not_carried_out_looks_again_and_again():
    car = Car(START, [Action.FORWARD] * 5, carries_out=False)
    for _ in range(200):
        car.step()
        car.pose = START
    assert len(car.asked) >= 4 and car.journey.actions == 0


def test_the_track_interpolates_also_across_the_turn_of_the_circle():
    track = Track()
    track.add(TimedPose(1.0, Pose(0.0, 0.0, math.pi - 0.1)))
    track.add(TimedPose(2.0, Pose(1.0, 0.0, -math.pi + 0.1)))
    assert track.at(1.5) == pytest.approx((0.5, 0.0, math.pi), abs=1e-9)
    assert track.at(0.0).x_m == 0.0 and track.at(9.0).x_m == 1.0
