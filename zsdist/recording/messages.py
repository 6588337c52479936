"""Messages of a recording: ROS 2 types, and two of our own for what a learner needs.

All are serialised as CDR by `rosbags`, and each file holds their definitions, so any tool for ROS 2 reads all of them.
"""

import math
from functools import cache
from typing import Any

import cv2
import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from zsdist.planning.grid import Grid
from zsdist.types import Pose

PICTURES, ODOMETRY, COMMANDS = "/camera/image/compressed", "/odom", "/cmd_vel"
GOAL, BELIEF = "/goal_pose", "/belief_map"
STEPS, TRANSITIONS, EPISODE = "/zsdist/step", "/zsdist/transitions", "/zsdist/episode"  # topics

STEP = "zsdist_msgs/msg/Step"
TRAJECTORY = "zsdist_msgs/msg/Transitions"
TEXT = "std_msgs/msg/String"
_OWN = {
    STEP: """builtin_interfaces/Time stamp
uint32 number
uint8 action
float64 reward_distance
float64 reward_safety
float64 reward_goal
bool terminated
bool truncated
""",
    TRAJECTORY: """string level
uint32 count
uint8[] frame
""",
}
ODOM, BASE, CAMERA = "odom", "base_link", "camera"  # frames
FREE, OCCUPIED, UNKNOWN = 0, 100, -1  # cells of an OccupancyGrid
JPEG_QUALITY = 95
PNG_COMPRESSION = 1  # the quickest; pictures of a simulation compress well
NS = 1_000_000_000


@cache
def types() -> Typestore:
    """Return the types of ROS 2 Jazzy and our own."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _OWN.items():
        store.register(get_types_from_msg(text, name))
    return store


def definition(kind: str) -> bytes:
    """Return the definition of a type and of all that it consists of, in the form `ros2msg`."""
    text, _ = types().generate_msgdef(kind, ros_version=2)
    return text.encode()


def encode(message: Any) -> bytes:
    """Return a message of `types` as CDR."""
    return bytes(types().serialize_cdr(message, message.__msgtype__))


def decode(kind: str, content: bytes) -> Any:
    """Return the message of a type in CDR."""
    return types().deserialize_cdr(content, kind)


def compressed_image(picture: np.ndarray, time_ns: int, form: str = "jpeg") -> Any:
    """Return a picture as `sensor_msgs/msg/CompressedImage`.

    Args:
        picture: `(h, w, 3)` uint8, RGB.
        time_ns: time of the picture, nanoseconds.
        form: `jpeg`, or `png`, which keeps every bit.
    """
    settings = {"jpeg": [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY], "png": [cv2.IMWRITE_PNG_COMPRESSION, PNG_COMPRESSION]}
    _, content = cv2.imencode(f".{form}", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), settings[form])
    return _new("sensor_msgs/msg/CompressedImage", header=_header(time_ns, CAMERA), format=form, data=content.ravel())


def picture_of(message: Any) -> np.ndarray:
    """Return the picture of a `CompressedImage`, `(h, w, 3)` uint8, RGB."""
    picture: np.ndarray = cv2.cvtColor(cv2.imdecode(message.data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
    return picture


def odometry(pose: Pose, time_ns: int) -> Any:
    """Return a pose as `nav_msgs/msg/Odometry`, with unknown speeds as zeros."""
    placed = _new("geometry_msgs/msg/PoseWithCovariance", pose=_pose(pose), covariance=np.zeros(36))
    moving = _new("geometry_msgs/msg/TwistWithCovariance", twist=twist(0.0, 0.0), covariance=np.zeros(36))
    return _new("nav_msgs/msg/Odometry", header=_header(time_ns, ODOM), child_frame_id=BASE, pose=placed, twist=moving)


def pose_of(message: Any) -> Pose:
    """Return the pose of an `Odometry`."""
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    return Pose(place.x, place.y, math.remainder(2 * math.atan2(turn.z, turn.w), math.tau))


def goal_pose(goal: tuple[float, float], time_ns: int) -> Any:
    """Return a goal `(x_m, y_m)` as `geometry_msgs/msg/PoseStamped`; its heading says nothing."""
    return _new("geometry_msgs/msg/PoseStamped", header=_header(time_ns, ODOM), pose=_pose(Pose(*goal, 0.0)))


def goal_of(message: Any) -> tuple[float, float]:
    """Return the goal `(x_m, y_m)` of a `PoseStamped`."""
    return message.pose.position.x, message.pose.position.y


def twist(forward_mps: float, turn_rad_s: float) -> Any:
    """Return speeds as `geometry_msgs/msg/Twist`."""
    vector = "geometry_msgs/msg/Vector3"
    linear, angular = _new(vector, x=forward_mps, y=0.0, z=0.0), _new(vector, x=0.0, y=0.0, z=turn_rad_s)
    return _new("geometry_msgs/msg/Twist", linear=linear, angular=angular)


def occupancy_grid(grid: Grid, occupied: np.ndarray, seen: np.ndarray, time_ns: int) -> Any:
    """Return a believed map as `nav_msgs/msg/OccupancyGrid`.

    Args:
        grid: planning grid, whose fine cells the map has.
        occupied: `(fine_size, fine_size)` bool, cells that count as occupied.
        seen: `(fine_size, fine_size)` bool, cells that were seen.
        time_ns: time of the map, nanoseconds.
    """
    corner = -grid.arena_m / 2
    about = _new(
        "nav_msgs/msg/MapMetaData",
        map_load_time=_time(time_ns),
        resolution=grid.fine_m,
        width=grid.fine_size,
        height=grid.fine_size,
        origin=_pose(Pose(corner, corner, 0.0)),
    )
    cells = np.where(occupied, OCCUPIED, np.where(seen, FREE, UNKNOWN)).astype(np.int8).ravel()
    return _new("nav_msgs/msg/OccupancyGrid", header=_header(time_ns, ODOM), info=about, data=cells)


def step(number: int, action: int, rewards: tuple[float, float, float], ended: str, time_ns: int) -> Any:
    """Return one action and its result.

    Args:
        number: number of the action in its episode, from 0.
        action: the action, `zsdist.types.Action`.
        rewards: the paper's terms for distance, safety and goal.
        ended: `terminated` or `truncated` where the action ended the episode; else empty.
        time_ns: time of the picture on which it was decided, nanoseconds.
    """
    distance, safety, goal = rewards
    return _new(
        STEP,
        stamp=_time(time_ns),
        number=number,
        action=action,
        reward_distance=distance,
        reward_safety=safety,
        reward_goal=goal,
        terminated=ended == "terminated",
        truncated=ended == "truncated",
    )


def transitions(level: str, count: int, frame: bytes) -> Any:
    """Return `count` transitions of a level, as the bytes of a message from an actor to the replay."""
    return _new(TRAJECTORY, level=level, count=count, frame=np.frombuffer(frame, np.uint8))


def text(content: str) -> Any:
    """Return a text as `std_msgs/msg/String`."""
    return _new(TEXT, data=content)


def _new(kind: str, **fields: Any) -> Any:
    return types().types[kind](**fields)


def _time(time_ns: int) -> Any:
    return _new("builtin_interfaces/msg/Time", sec=time_ns // NS, nanosec=time_ns % NS)


def _header(time_ns: int, frame: str) -> Any:
    return _new("std_msgs/msg/Header", stamp=_time(time_ns), frame_id=frame)


def _pose(pose: Pose) -> Any:
    half = pose.heading_rad / 2
    turn = _new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))
    return _new(
        "geometry_msgs/msg/Pose",
        position=_new("geometry_msgs/msg/Point", x=pose.x_m, y=pose.y_m, z=0.0),
        orientation=turn,
    )
