"""The car of Table 1 as a PyBullet body.

The wheels are spheres, driven each on its own axle and steered by skidding: they alone touch the ground. A skin on the
base, the cabinet and the outlines of the wheels, alone touches obstacles.
"""

import math

from zsdist.common.compiled import compiled
from zsdist.sim.bullet import pybullet
from zsdist.sim.physics.controller import STOPPED, WHEEL_RADIUS_M, Motion, Rates
from zsdist.types import Pose

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
        self._commanded: Rates | None = None
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
        """Sets the rates at which the four motors turn their wheels, which they do until told otherwise."""
        if rates == self._commanded:
            return
        self._commanded = rates
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
        moving = self.moving()
        heading, speed_mps, turn_rate = heading_and_speed(*moving)
        return Motion(Pose(moving[0], moving[1], heading), speed_mps, turn_rate)

    def moving(self) -> tuple[float, ...]:
        """The true motion as PyBullet has it, for `heading_and_speed`.

        Returns:
            Place in x and y, quaternion x, y, z, w, velocity in x and y, turn rate; metres, seconds, radians.
        """
        (x_m, y_m, _), turned = pybullet.getBasePositionAndOrientation(self.body, self._client)
        (east, north, _), (_, _, turn_rate) = pybullet.getBaseVelocity(self.body, self._client)
        return x_m, y_m, *turned, east, north, turn_rate

    def tilt(self) -> tuple[float, float]:
        """Roll, right side down positive, and pitch, nose down positive, in radians."""
        _, turned = pybullet.getBasePositionAndOrientation(self.body, physicsClientId=self._client)
        return pybullet.getEulerFromQuaternion(turned)[:2]

    def contact(self) -> bool:
        """Whether PyBullet found the skin to touch an obstacle or pushed it off one when it last looked."""
        points = pybullet.getContactPoints(bodyA=self.body, linkIndexA=-1, physicsClientId=self._client)
        return any(point[_DISTANCE] <= 0.0 or point[_NORMAL_FORCE] > 0.0 for point in points)


_DISTANCE, _NORMAL_FORCE = 8, 9  # fields of a PyBullet contact point


@compiled()
def heading_and_speed(
    x_m: float,
    y_m: float,
    qx: float,
    qy: float,
    qz: float,
    qw: float,
    east_mps: float,
    north_mps: float,
    turn_rate: float,
) -> tuple[float, float, float]:
    """Heading, speed along it and turn rate of a car that moves as `Car.moving` says."""
    heading = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
    return heading, east_mps * math.cos(heading) + north_mps * math.sin(heading), turn_rate
