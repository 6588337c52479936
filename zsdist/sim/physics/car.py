"""Car of Table 1 as a PyBullet body.

The wheels are spheres with an axle and a motor each; the car steers by skidding. Only the wheels touch the ground, and
only a skin on the base touches obstacles. The skin has the shape of the cabinet and the outlines of the wheels.
"""

import math

from zsdist.common.compiled import compiled
from zsdist.sim.bullet import pybullet
from zsdist.sim.physics.controller import STOPPED, WHEEL_RADIUS_M, Motion, Rates
from zsdist.types import Pose

TREAD_M = 1.0  # Table 1: distance between the left and the right wheels
CABINET_M = (2.0, 0.9, 0.6)  # length and width as in Table 1; the paper gives no height
CABINET_HEIGHT_M = 0.6  # height of the cabinet's centre
WHEEL_WIDTH_M = 0.09
AXLES_M = 0.52  # distance of the axles ahead of and behind the centre
CENTRE_OF_MASS_M = 0.3  # height above the ground; if it is higher, the car rears up
CABINET_KG = 80.0
WHEEL_KG = 4.0
AXLE_INERTIA_KG_M2 = 5.0  # ten times a solid wheel's; with less, turns are slow; with 15 or more, the car rears up
WHEEL_FRICTION = 1.5
MOTOR_NM = 400.0

# Two bodies collide if the group of each is in the mask of the other.
GROUND_GROUP, WHEEL_GROUP, SKIN_GROUP, OBSTACLE_GROUP = 1, 2, 4, 8

_WHEELS = [(AXLES_M, TREAD_M / 2), (AXLES_M, -TREAD_M / 2), (-AXLES_M, TREAD_M / 2), (-AXLES_M, -TREAD_M / 2)]
_UPRIGHT = [0.0, 0.0, 0.0, 1.0]
_ACROSS = [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]  # a cylinder's axis along the axle


class CarBody:
    """Body of the car in a physics client.

    Args:
        client: number of the PyBullet client.

    Attributes:
        body: number of the PyBullet body.
    """

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
        # One property per call: PyBullet writes a wheel's friction to the base if several are given together.
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
        """Put the car at rest at `pose`, without any effect of its earlier motion."""
        quaternion = pybullet.getQuaternionFromEuler([0.0, 0.0, pose.heading_rad])
        self.command(STOPPED)
        position = [pose.x_m, pose.y_m, CENTRE_OF_MASS_M]
        pybullet.resetBasePositionAndOrientation(self.body, position, quaternion, physicsClientId=self._client)
        pybullet.resetBaseVelocity(self.body, [0.0] * 3, [0.0] * 3, physicsClientId=self._client)
        for wheel in self._wheels:
            pybullet.resetJointState(self.body, wheel, 0.0, 0.0, physicsClientId=self._client)

    def command(self, rates: Rates) -> None:
        """Set the rates of the four wheels; the motors keep them until the next command."""
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
        """Return the true pose, speed and turn rate of the car."""
        raw = self.raw_motion()
        heading, speed_mps, turn_rate = heading_and_speed(*raw)
        return Motion(Pose(raw[0], raw[1], heading), speed_mps, turn_rate)

    def raw_motion(self) -> tuple[float, ...]:
        """Return the true motion in PyBullet's numbers, for `heading_and_speed`.

        Returns:
            Position in x and y, quaternion x, y, z, w, velocity in x and y, turn rate; in metres, seconds and radians.
        """
        (x_m, y_m, _), quaternion = pybullet.getBasePositionAndOrientation(self.body, self._client)
        (east, north, _), (_, _, turn_rate) = pybullet.getBaseVelocity(self.body, self._client)
        return x_m, y_m, *quaternion, east, north, turn_rate

    def tilt(self) -> tuple[float, float]:
        """Return roll (right side down positive) and pitch (nose down positive) in radians."""
        _, quaternion = pybullet.getBasePositionAndOrientation(self.body, physicsClientId=self._client)
        return pybullet.getEulerFromQuaternion(quaternion)[:2]

    def contact(self) -> bool:
        """Return whether the skin touched an obstacle, or was pushed off one, in PyBullet's last detection."""
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
    """Return heading (rad), speed along it (m/s) and turn rate (rad/s) from the numbers of `CarBody.raw_motion`."""
    heading = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
    return heading, east_mps * math.cos(heading) + north_mps * math.sin(heading), turn_rate
