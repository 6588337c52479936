"""Messages of ROS 2 that robots and drivers exchange: their types, and their bytes (CDR), by the library rosbags."""

import math
from typing import Any, NamedTuple

import numpy as np
from rosbags.typesys import Stores, get_typestore

from zsdist.errors import DecodeError
from zsdist.ros2.keys import TopicType
from zsdist.types import Pose

NS_PER_S = 1_000_000_000
_STORE = get_typestore(Stores.ROS2_JAZZY)
_TYPES = _STORE.types


def _topic_type(name: str) -> TopicType:
    return TopicType(name, _STORE.hash_rihs01(name))


TWIST = _topic_type("geometry_msgs/msg/Twist")
TWIST_STAMPED = _topic_type("geometry_msgs/msg/TwistStamped")
ODOMETRY = _topic_type("nav_msgs/msg/Odometry")
COMPRESSED_IMAGE = _topic_type("sensor_msgs/msg/CompressedImage")
POSE_STAMPED = _topic_type("geometry_msgs/msg/PoseStamped")
BOOL = _topic_type("std_msgs/msg/Bool")
CLOCK = _topic_type("rosgraph_msgs/msg/Clock")


class Velocity(NamedTuple):
    """Velocity of a robot: along its heading in m/s, and turn rate in rad/s, counter-clockwise positive."""

    speed_mps: float
    turn_rad_s: float


class OdometryReading(NamedTuple):
    """Content of an odometry message.

    Attributes:
        time_ns: stamp of the robot.
        pose: pose in the frame `frame`.
        velocity: velocity of the robot.
        frame: frame of the pose, usually `odom`.
        child: frame whose pose it is, usually `base_link`.
    """

    time_ns: int
    pose: Pose
    velocity: Velocity
    frame: str = "odom"
    child: str = "base_link"


class CompressedPicture(NamedTuple):
    """Content of a compressed image: stamp of the robot, bytes of a JPEG or PNG file, frame and format."""

    time_ns: int
    data: np.ndarray
    frame: str = "camera"
    format: str = "jpeg"


class GoalReading(NamedTuple):
    """Content of a goal: position in metres, and the frame that it is in."""

    position_m: tuple[float, float]
    frame: str


def encode_twist(velocity: Velocity, time_ns: int | None = None, frame: str = "base_link") -> bytes:
    """Return a Twist, or with a time a TwistStamped."""
    vector = _TYPES["geometry_msgs/msg/Vector3"]
    linear, angular = vector(x=velocity.speed_mps, y=0.0, z=0.0), vector(x=0.0, y=0.0, z=velocity.turn_rad_s)
    twist = _TYPES[TWIST.name](linear=linear, angular=angular)
    if time_ns is None:
        return _encode(twist, TWIST)
    return _encode(_TYPES[TWIST_STAMPED.name](header=_header(time_ns, frame), twist=twist), TWIST_STAMPED)


def decode_twist(data: bytes) -> Velocity:
    """Return the velocity of a Twist; raise `DecodeError` if it is none or not finite."""
    message = _decode(data, TWIST)
    return Velocity(*_finite(TWIST, message.linear.x, message.angular.z))


def decode_twist_stamped(data: bytes) -> Velocity:
    """Return the velocity of a TwistStamped; raise `DecodeError` if it is none or not finite."""
    message = _decode(data, TWIST_STAMPED)
    return Velocity(*_finite(TWIST_STAMPED, message.twist.linear.x, message.twist.angular.z))


def encode_odometry(reading: OdometryReading, deviation_m: float = 0.0, deviation_rad: float = 0.0) -> bytes:
    """Return an odometry message with the standard deviations of its pose."""
    pose, velocity = reading.pose, reading.velocity
    point, vector = _TYPES["geometry_msgs/msg/Point"], _TYPES["geometry_msgs/msg/Vector3"]
    covariance = np.zeros(36)
    covariance[[0, 7]], covariance[35] = deviation_m**2, deviation_rad**2
    located = _TYPES["geometry_msgs/msg/Pose"](
        position=point(x=pose.x_m, y=pose.y_m, z=0.0), orientation=_quaternion(pose.heading_rad)
    )
    twist = _TYPES[TWIST.name](
        linear=vector(x=velocity.speed_mps, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=velocity.turn_rad_s)
    )
    message = _TYPES[ODOMETRY.name](
        header=_header(reading.time_ns, reading.frame),
        child_frame_id=reading.child,
        pose=_TYPES["geometry_msgs/msg/PoseWithCovariance"](pose=located, covariance=covariance),
        twist=_TYPES["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
    )
    return _encode(message, ODOMETRY)


def decode_odometry(data: bytes) -> OdometryReading:
    """Return the reading of an odometry message; raise `DecodeError` if it is none or not finite."""
    message = _decode(data, ODOMETRY)
    position, turned = message.pose.pose.position, message.pose.pose.orientation
    numbers = _finite(ODOMETRY, position.x, position.y, turned.x, turned.y, turned.z, turned.w)
    x_m, y_m, qx, qy, qz, qw = numbers
    if not 0.5 < math.hypot(qx, qy, qz, qw) < 1.5:
        raise DecodeError("quaternion", f"its length is not 1 in {ODOMETRY.name}")
    heading_rad = math.atan2(2 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2)
    twist = message.twist.twist
    velocity = Velocity(*_finite(ODOMETRY, twist.linear.x, twist.angular.z))
    time_ns = _time_ns(message.header.stamp)
    return OdometryReading(
        time_ns, Pose(x_m, y_m, heading_rad), velocity, message.header.frame_id, message.child_frame_id
    )


def encode_picture(picture: CompressedPicture) -> bytes:
    """Return a CompressedImage."""
    header = _header(picture.time_ns, picture.frame)
    message = _TYPES[COMPRESSED_IMAGE.name](header=header, format=picture.format, data=picture.data)
    return _encode(message, COMPRESSED_IMAGE)


def decode_picture(data: bytes) -> CompressedPicture:
    """Return the content of a CompressedImage, its picture still compressed; raise `DecodeError` if it is none."""
    message = _decode(data, COMPRESSED_IMAGE)
    header = message.header
    return CompressedPicture(_time_ns(header.stamp), message.data, header.frame_id, message.format)


def encode_goal(position_m: tuple[float, float], frame: str, time_ns: int = 0) -> bytes:
    """Return a PoseStamped with a goal."""
    point = _TYPES["geometry_msgs/msg/Point"](x=position_m[0], y=position_m[1], z=0.0)
    pose = _TYPES["geometry_msgs/msg/Pose"](position=point, orientation=_quaternion(0.0))
    return _encode(_TYPES[POSE_STAMPED.name](header=_header(time_ns, frame), pose=pose), POSE_STAMPED)


def decode_goal(data: bytes) -> GoalReading:
    """Return the goal of a PoseStamped, without its heading; raise `DecodeError` if it is none or not finite."""
    message = _decode(data, POSE_STAMPED)
    x_m, y_m = _finite(POSE_STAMPED, message.pose.position.x, message.pose.position.y)
    return GoalReading((x_m, y_m), message.header.frame_id)


def encode_bool(value: bool) -> bytes:
    """Return a Bool."""
    return _encode(_TYPES[BOOL.name](data=value), BOOL)


def decode_bool(data: bytes) -> bool:
    """Return the value of a Bool; raise `DecodeError` if it is none."""
    return bool(_decode(data, BOOL).data)


def encode_clock(time_ns: int) -> bytes:
    """Return a Clock."""
    return _encode(_TYPES[CLOCK.name](clock=_stamp(time_ns)), CLOCK)


def decode_clock(data: bytes) -> int:
    """Return the time of a Clock in nanoseconds; raise `DecodeError` if it is none."""
    return _time_ns(_decode(data, CLOCK).clock)


def _encode(message: Any, kind: TopicType) -> bytes:
    return bytes(_STORE.serialize_cdr(message, kind.name))


def _decode(data: bytes, kind: TopicType) -> Any:
    try:
        return _STORE.deserialize_cdr(data, kind.name)
    except Exception as error:  # rosbags raises what its generated code meets: errors of struct, numpy, indices, text
        raise DecodeError("cdr", f"{len(data)} bytes are no {kind.name}: {error}") from error


def _finite(kind: TopicType, *values: float) -> tuple[float, ...]:
    if not all(map(math.isfinite, values)):
        raise DecodeError("finite", f"a value of {kind.name} is not finite")
    return values


def _stamp(time_ns: int) -> Any:
    seconds, nanoseconds = divmod(time_ns, NS_PER_S)
    return _TYPES["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)


def _time_ns(stamp: Any) -> int:
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def _header(time_ns: int, frame: str) -> Any:
    return _TYPES["std_msgs/msg/Header"](stamp=_stamp(time_ns), frame_id=frame)


def _quaternion(heading_rad: float) -> Any:
    half = heading_rad / 2
    return _TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))
