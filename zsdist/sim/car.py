"""The car of Table 1 as a PyBullet body, and the controller that turns one lattice action into four wheel rates.

The wheels are spheres, driven each on its own axle and steered by skidding: they alone touch the ground. A skin on the
base, the cabinet and the outlines of the wheels, alone touches obstacles.
"""

import math
from enum import Enum
from typing import NamedTuple

from zsdist.sim.bullet import pybullet
from zsdist.types import Pose

WHEEL_RADIUS_M = 0.5  # Table 1
TREAD_M = 1.0  # Table 1: between the left and the right wheels
CABINET_M = (2.0, 0.9, 0.6)  # Table 1; its height is ours
CABINET_HEIGHT_M = 0.6  # of the cabinet's centre
WHEEL_WIDTH_M = 0.09
AXLES_M = 0.52  # ahead of and behind the centre
CENTRE_OF_MASS_M = 0.3  # above the ground: higher, and the car rears up
CABINET_KG = 80.0
WHEEL_KG = 4.0
AXLE_INERTIA_KG_M2 = 5.0  # ten times a solid wheel's: lower, and turns creep; 15 and more, and the car rears up
WHEEL_FRICTION = 1.5
MOTOR_NM = 400.0

# Who collides with whom: a body's group must be in the other's mask, both ways.
GROUND_GROUP, WHEEL_GROUP, SKIN_GROUP, OBSTACLE_GROUP = 1, 2, 4, 8

_WHEELS = [(AXLES_M, TREAD_M / 2), (AXLES_M, -TREAD_M / 2), (-AXLES_M, TREAD_M / 2), (-AXLES_M, -TREAD_M / 2)]
_UPRIGHT = [0.0, 0.0, 0.0, 1.0]
_ACROSS = [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]  # a cylinder's axis along the axle


class Motion(NamedTuple):
    """Where the car is and how it moves: `speed_mps` along its heading, `turn_rate_rad_s` counter-clockwise."""

    pose: Pose
    speed_mps: float
    turn_rate_rad_s: float


class Rates(NamedTuple):
    """Wheel rates in radians a second, forward positive; both wheels of a side turn alike."""

    left: float
    right: float


STOPPED = Rates(0.0, 0.0)


class Car:
    """The body, in the physics client `client`."""

    def __init__(self, client: int) -> None:
        self._client = client
        wheels = len(_WHEELS)
        skin = pybullet.createCollisionShapeArray(
            shapeTypes=[pybullet.GEOM_BOX] + [pybullet.GEOM_CYLINDER] * wheels,
            halfExtents=[[side / 2 for side in CABINET_M]] + [[0.0, 0.0, 0.0]] * wheels,
            radii=[0.0] + [WHEEL_RADIUS_M] * wheels,
            lengths=[0.0] + [WHEEL_WIDTH_M] * wheels,
            collisionFramePositions=[[0.0, 0.0, CABINET_HEIGHT_M]] + [[x, y, WHEEL_RADIUS_M] for x, y in _WHEELS],
            collisionFrameOrientations=[_UPRIGHT] + [_ACROSS] * wheels,
            physicsClientId=client,
        )
        ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=WHEEL_RADIUS_M, physicsClientId=client)
        self.body = pybullet.createMultiBody(
            baseMass=CABINET_KG,
            baseCollisionShapeIndex=skin,
            baseInertialFramePosition=[0.0, 0.0, CENTRE_OF_MASS_M],
            linkMasses=[WHEEL_KG] * wheels,
            linkCollisionShapeIndices=[ball] * wheels,
            linkVisualShapeIndices=[-1] * wheels,
            linkPositions=[[x, y, WHEEL_RADIUS_M] for x, y in _WHEELS],
            linkOrientations=[_UPRIGHT] * wheels,
            linkInertialFramePositions=[[0.0, 0.0, 0.0]] * wheels,
            linkInertialFrameOrientations=[_UPRIGHT] * wheels,
            linkParentIndices=[0] * wheels,
            linkJointTypes=[pybullet.JOINT_REVOLUTE] * wheels,
            linkJointAxis=[[0.0, 1.0, 0.0]] * wheels,
            physicsClientId=client,
        )
        self._wheels = list(range(wheels))
        self._torques = [MOTOR_NM] * wheels
        pybullet.setCollisionFilterGroupMask(self.body, -1, SKIN_GROUP, OBSTACLE_GROUP, physicsClientId=client)
        # One property a call: given together, PyBullet writes a wheel's friction to the base.
        rolling_inertia = 0.4 * WHEEL_KG * WHEEL_RADIUS_M**2
        for wheel in self._wheels:
            pybullet.setCollisionFilterGroupMask(self.body, wheel, WHEEL_GROUP, GROUND_GROUP, physicsClientId=client)
            pybullet.changeDynamics(self.body, wheel, lateralFriction=WHEEL_FRICTION, physicsClientId=client)
            inertia = [rolling_inertia, AXLE_INERTIA_KG_M2, rolling_inertia]
            pybullet.changeDynamics(self.body, wheel, localInertiaDiagonal=inertia, physicsClientId=client)
        pybullet.changeDynamics(self.body, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=client)
        awake = pybullet.ACTIVATION_STATE_DISABLE_SLEEPING
        pybullet.changeDynamics(self.body, -1, activationState=awake, physicsClientId=client)

    def place(self, pose: Pose) -> None:
        """Stands the car still at `pose`, as if it had never been anywhere else."""
        turned = pybullet.getQuaternionFromEuler([0.0, 0.0, pose.heading_rad])
        self.command(STOPPED)
        position = [pose.x_m, pose.y_m, CENTRE_OF_MASS_M]
        pybullet.resetBasePositionAndOrientation(self.body, position, turned, physicsClientId=self._client)
        pybullet.resetBaseVelocity(self.body, [0.0] * 3, [0.0] * 3, physicsClientId=self._client)
        for wheel in self._wheels:
            pybullet.resetJointState(self.body, wheel, 0.0, 0.0, physicsClientId=self._client)

    def command(self, rates: Rates) -> None:
        """Sets the rates at which the four motors turn their wheels."""
        left, right = rates
        pybullet.setJointMotorControlArray(
            self.body,
            self._wheels,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=[left, right, left, right],
            forces=self._torques,
            physicsClientId=self._client,
        )

    def motion(self) -> Motion:
        """The true motion."""
        client = self._client
        (x_m, y_m, _), (qx, qy, qz, qw) = pybullet.getBasePositionAndOrientation(self.body, physicsClientId=client)
        (east, north, _), (_, _, turn_rate) = pybullet.getBaseVelocity(self.body, physicsClientId=client)
        heading = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
        return Motion(Pose(x_m, y_m, heading), east * math.cos(heading) + north * math.sin(heading), turn_rate)

    def tilt(self) -> tuple[float, float]:
        """Roll, right side down positive, and pitch, nose down positive, in radians."""
        _, turned = pybullet.getBasePositionAndOrientation(self.body, physicsClientId=self._client)
        return pybullet.getEulerFromQuaternion(turned)[:2]

    def contact(self) -> bool:
        """Whether PyBullet found the skin to touch an obstacle or pushed it off one when it last looked."""
        points = pybullet.getContactPoints(bodyA=self.body, linkIndexA=-1, physicsClientId=self._client)
        return any(point[_DISTANCE] <= 0.0 or point[_NORMAL_FORCE] > 0.0 for point in points)


_DISTANCE, _NORMAL_FORCE = 8, 9  # fields of a PyBullet contact point


class Gains(NamedTuple):
    """The controller's constants; the defaults were found by a random search over driven sequences."""

    turn: float = 16.0  # wheel rate (rad/s) per radian of heading error, in place
    turn_most_rad_s: float = 11.0
    turn_least_rad_s: float = 2.5  # below this the wheels only strain against friction
    aligned_rad: float = 0.07  # a heading this close ends a turn in place
    calm_rad_s: float = 0.45  # and so slow a turn
    facing_rad: float = 0.27  # a heading this close lets the advance begin
    hold: float = 4.5  # speed (1/s) per metre off the place, turning in place
    hold_most_mps: float = 0.3
    still_mps: float = 0.1  # a turn begins once the car is this slow: turning at speed, it slides off its place
    speed_most_mps: float = 1.75
    speed_up_mps2: float = 5.0
    slow_down_mps2: float = 4.0
    arrive_m: float = 0.1  # so close ahead of the target the advance ends: about the way it takes to stop
    arrive_mps: float = 1.2  # if the car is this slow
    flow_mps: float = 1.0  # speed asked for at the target, so that an advance that follows need not start from rest
    look_ahead_m: float = 0.8  # least distance over which an offset to the side is taken out
    aim_most_rad: float = 0.17
    steer: float = 9.3  # wheel rate (rad/s) per radian of heading error, driving
    damp: float = 0.5  # wheel rate per turn rate


GAINS = Gains()


class _Phase(Enum):
    BRAKE = 1
    TURN = 2  # in place, towards the line to the target
    ADVANCE = 3
    ALIGN = 4  # in place, to the target's heading


class Manoeuvre:
    """Drives the car to one target pose: brake and turn in place first, then advance along its heading, then align.

    An advance ends while the car still rolls, so near the target that it would come to rest there.

    Args:
        target: pose to end at.
        advance: False for a turn in place.
        turn: whether a turn comes first; without one a speed from the manoeuvre before is kept.
        step_s: time between two calls of `rates`.
        gains: constants of the control law.
    """

    def __init__(self, target: Pose, advance: bool, turn: bool, step_s: float, gains: Gains = GAINS) -> None:
        self.target = target
        self._step_s = step_s
        self._gains = gains
        self._advances = advance
        self._phase = _Phase.BRAKE if turn or not advance else _Phase.ADVANCE
        self._speed_mps: float | None = None  # last asked for

    def rates(self, motion: Motion) -> Rates | None:
        """The wheel rates for the next step; None once the car is there."""
        gains = self._gains
        pose = motion.pose
        cos, sin = math.cos(self.target.heading_rad), math.sin(self.target.heading_rad)
        east, north = self.target.x_m - pose.x_m, self.target.y_m - pose.y_m
        ahead, aside = east * cos + north * sin, north * cos - east * sin
        turn = math.remainder(self.target.heading_rad - pose.heading_rad, math.tau)
        aim = turn + _clip(aside / max(ahead, gains.look_ahead_m), gains.aim_most_rad)
        if self._phase is _Phase.BRAKE:
            if motion.speed_mps > gains.still_mps:
                return STOPPED
            self._phase = _Phase.TURN if self._advances else _Phase.ALIGN
        if self._phase is _Phase.TURN and abs(aim) < gains.facing_rad:
            self._phase = _Phase.ADVANCE
        if self._phase is _Phase.ADVANCE and ahead < gains.arrive_m and motion.speed_mps < gains.arrive_mps:
            self._phase = _Phase.ALIGN
        if self._phase is _Phase.TURN:
            return self._spin(aim, 0.0)
        if self._phase is _Phase.ADVANCE:
            return self._advance(motion, ahead, aim)
        off = east * math.cos(pose.heading_rad) + north * math.sin(pose.heading_rad)
        if abs(turn) >= gains.aligned_rad:
            return self._spin(turn, _clip(gains.hold * off, gains.hold_most_mps))
        return None if abs(motion.turn_rate_rad_s) < gains.calm_rad_s else STOPPED

    def _spin(self, turn: float, speed_mps: float) -> Rates:
        gains = self._gains
        rate = math.copysign(min(max(gains.turn * abs(turn), gains.turn_least_rad_s), gains.turn_most_rad_s), turn)
        return _skid(speed_mps, rate)

    def _advance(self, motion: Motion, ahead: float, aim: float) -> Rates:
        gains = self._gains
        before = motion.speed_mps if self._speed_mps is None else self._speed_mps
        braking = math.sqrt(2 * gains.slow_down_mps2 * ahead + gains.flow_mps**2) if ahead > 0 else 0.0
        self._speed_mps = max(0.0, min(gains.speed_most_mps, braking, before + gains.speed_up_mps2 * self._step_s))
        rate = _clip(gains.steer * aim - gains.damp * motion.turn_rate_rad_s, gains.turn_most_rad_s)
        return _skid(self._speed_mps, rate)


def _skid(speed_mps: float, rate: float) -> Rates:
    forward = speed_mps / WHEEL_RADIUS_M
    return Rates(forward - rate, forward + rate)


def _clip(value: float, most: float) -> float:
    return max(-most, min(most, value))
