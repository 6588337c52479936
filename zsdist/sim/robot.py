"""Simulated robot: the car under velocity commands, its odometry with errors, and the faults of its camera."""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from zsdist.planning.footprint import CAR_LENGTH_M, CAR_WIDTH_M
from zsdist.sim.bullet import pybullet
from zsdist.sim.physics.collision import box_clearance
from zsdist.sim.physics.controller import WHEEL_RADIUS_M, Motion, Rates
from zsdist.sim.physics.world import CONTACT_WITHIN_M, SETTLE_STEPS, World
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose

BRAKES_AFTER_S = 0.3  # time without a command after which the base brakes by itself
FASTEST_MPS, FASTEST_RAD_S = 2.0, 3.5
_SPEED_UP_MPS2, _TURN_UP_RAD_S2 = 4.0, 12.0  # changes of the base's demanded velocity
_SLIP = 2.9  # wheel rate per turn rate: the car turns by skidding
_HOLD_TURN = 3.0  # wheel rate per error of the turn rate
_MOST_TURN = 11.0  # wheel rate
JPEG_QUALITY = 95


class BaseController:
    """Velocity control of the base: velocities in, wheel rates out.

    Args:
        step_s: seconds between two calls.
    """

    def __init__(self, step_s: float) -> None:
        self._step_s = step_s
        self._speed_mps = self._turn_rad_s = 0.0  # demanded now

    def rates(self, speed_mps: float, turn_rad_s: float, motion: Motion) -> Rates:
        """Return the wheel rates of the next step.

        Args:
            speed_mps: commanded speed, negative backward.
            turn_rad_s: commanded turn rate.
            motion: true motion of the car.
        """
        self._speed_mps = _approach(self._speed_mps, _clip(speed_mps, FASTEST_MPS), _SPEED_UP_MPS2 * self._step_s)
        self._turn_rad_s = _approach(self._turn_rad_s, _clip(turn_rad_s, FASTEST_RAD_S), _TURN_UP_RAD_S2 * self._step_s)
        if self._speed_mps == 0.0 and self._turn_rad_s == 0.0:
            return Rates(0.0, 0.0)
        error = self._turn_rad_s - motion.turn_rate_rad_s
        turn = _clip(_SLIP * self._turn_rad_s + _HOLD_TURN * error, _MOST_TURN)
        ahead = self._speed_mps / WHEEL_RADIUS_M
        return Rates(ahead - turn, ahead + turn)


class RobotWorld(World):
    """World in which the car obeys velocity commands, one simulation step at a time."""

    def begin(self, scene: Scene) -> None:
        """Set up a scene with the car at rest at its start, wherever that is.

        Raises:
            SceneError: an obstacle or a wall stands on the start.
        """
        self.reset(scene)
        self.put(scene.start.pose)  # a start off the lattice was driven onto it
        for _ in range(SETTLE_STEPS):
            pybullet.stepSimulation(physicsClientId=self._client)
        self._base = BaseController(self.step_s)

    @property
    def motion(self) -> Motion:
        """True motion of the car."""
        return self._car.motion()

    @property
    def clearance_m(self) -> float:
        """Distance of the car's box from the nearest obstacle or wall; 0 or less in contact."""
        pose = self.pose
        half = self.grid.arena_m / 2
        size = CAR_LENGTH_M / 2, CAR_WIDTH_M / 2
        return float(box_clearance(*pose, *size, self._circles, self._boxes, half))

    def step(self, speed_mps: float, turn_rad_s: float) -> bool:
        """Simulate one step under a command; return whether the car touches something."""
        motion = self.motion
        self._car.command(self._base.rates(speed_mps, turn_rad_s, motion))
        if self._walkers:
            self._walk(motion.pose)
        pybullet.stepSimulation(self._client)
        room_m = self.clearance_m
        return room_m <= 0.0 or (room_m < CONTACT_WITHIN_M and self._car.contact())


class OdometryErrors(NamedTuple):
    """Errors of the odometry.

    Attributes:
        scale: standard deviation of the error of distances, a share of them; it stays the same for a whole drive.
        heading_rad: standard deviation of the error of headings, which wanders.
        drift_rad_per_m: standard deviation of the heading's drift a metre, which stays the same for a whole drive.
        wander_s: time in which the error of headings forgets what it was.
    """

    scale: float = 0.0
    heading_rad: float = 0.0
    drift_rad_per_m: float = 0.0
    wander_s: float = 10.0


class SimulatedOdometry:
    """Odometry that adds up the car's steps, with errors.

    Args:
        start: true pose at which it begins.
        errors: its errors.
        rng: generator of the errors.
        step_s: seconds between two calls.
    """

    def __init__(self, start: Pose, errors: OdometryErrors, rng: np.random.Generator, step_s: float) -> None:
        self._errors, self._rng = errors, rng
        self._keep = math.exp(-step_s / errors.wander_s)
        self._scale = 1.0 + errors.scale * rng.standard_normal()
        self._drift = errors.drift_rad_per_m * rng.standard_normal()
        self._true = start
        self._x_m, self._y_m = start.x_m, start.y_m
        self._drifted_rad = self._wander_rad = 0.0

    def read(self, true: Pose) -> Pose:
        """Return the measured pose after a step to a true pose."""
        before, self._true = self._true, true
        east, north = true.x_m - before.x_m, true.y_m - before.y_m
        way_m = math.hypot(east, north)
        self._drifted_rad += self._drift * way_m
        noise = self._errors.heading_rad * math.sqrt(1 - self._keep**2) * self._rng.standard_normal()
        self._wander_rad = self._keep * self._wander_rad + noise
        wrong = self._drifted_rad + self._wander_rad
        cos, sin = self._scale * math.cos(wrong), self._scale * math.sin(wrong)
        self._x_m += cos * east - sin * north
        self._y_m += sin * east + cos * north
        return Pose(self._x_m, self._y_m, math.remainder(true.heading_rad + wrong, math.tau))


@dataclass(frozen=True)
class CameraFaults:
    """Faults of the camera and its link.

    Attributes:
        latency_s: time from a picture to its arrival.
        loss: share of pictures that never arrive.
        exposure: greatest change of the brightness, a share of it.
        exposure_period_s: time in which the brightness goes up and down.
    """

    latency_s: float = 0.0
    loss: float = 0.0
    exposure: float = 0.0
    exposure_period_s: float = 7.0


class LatePictures:
    """Line of pictures on their way, with the camera's faults.

    Args:
        faults: the faults.
        rng: generator of losses.
    """

    def __init__(self, faults: CameraFaults, rng: np.random.Generator) -> None:
        self._faults, self._rng = faults, rng
        self._under_way: deque[tuple[float, float, np.ndarray]] = deque()

    def take(self, time_s: float, picture: np.ndarray) -> None:
        """Take a picture `(h, w, 3)` uint8, RGB, at a time."""
        faults = self._faults
        if self._rng.random() < faults.loss:
            return
        if faults.exposure:
            gain = 1.0 + faults.exposure * math.sin(math.tau * time_s / faults.exposure_period_s)
            picture = np.clip(picture * np.float32(gain), 0, 255).astype(np.uint8)
        self._under_way.append((time_s + faults.latency_s, time_s, picture))

    def arrived(self, time_s: float) -> list[tuple[float, np.ndarray]]:
        """Return the pictures that have arrived by a time, with the times at which they were taken, in order."""
        found = []
        while self._under_way and self._under_way[0][0] <= time_s + 1e-9:
            _, taken_s, picture = self._under_way.popleft()
            found.append((taken_s, picture))
        return found


def jpeg(picture: np.ndarray) -> np.ndarray:
    """Return the bytes of a JPEG file of a picture `(h, w, 3)` uint8, RGB, as `(n,)` uint8."""
    settings = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    _, data = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), settings)
    return np.asarray(data).ravel()


def standing(motion: Motion) -> bool:
    """Return whether the car stands."""
    return abs(motion.speed_mps) < 0.05 and abs(motion.turn_rate_rad_s) < 0.1


def _approach(value: float, target: float, change: float) -> float:
    return min(max(target, value - change), value + change)


def _clip(value: float, most: float) -> float:
    return max(-most, min(most, value))
