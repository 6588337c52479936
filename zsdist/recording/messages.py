"""Messages that only recordings have: the believed map, and two types of our own for what a learner needs.

Those that robots send too are in `zsdist.ros2.messages`. All are CDR by `rosbags`, and each file holds the definitions
of its types, so any tool for ROS 2 reads all of them.
"""

from functools import cache
from typing import Any

import cv2
import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from zsdist.errors import DataError
from zsdist.planning.grid import Grid
from zsdist.ros2.messages import NS_PER_S

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
FRAME = "odom"  # of poses and maps
FREE, OCCUPIED, UNKNOWN = 0, 100, -1  # cells of an OccupancyGrid
JPEG_QUALITY = 95
PNG_COMPRESSION = 1  # the quickest; pictures of a simulation compress well


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


def compress(picture: np.ndarray, form: str = "jpeg") -> np.ndarray:
    """Return a picture `(h, w, 3)` uint8, RGB, as the bytes of a file: `jpeg`, or `png`, which keeps every bit."""
    settings = {"jpeg": [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY], "png": [cv2.IMWRITE_PNG_COMPRESSION, PNG_COMPRESSION]}
    _, content = cv2.imencode(f".{form}", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), settings[form])
    return np.asarray(content).ravel()


def decompress(content: np.ndarray) -> np.ndarray:
    """Return the picture in the bytes of a JPEG or PNG file, `(h, w, 3)` uint8, RGB.

    Raises:
        DataError: they are neither.
    """
    picture = cv2.imdecode(content, cv2.IMREAD_COLOR)
    if picture is None:
        raise DataError(f"a recorded picture of {content.nbytes} bytes is neither JPEG nor PNG; its file is damaged")
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))


def occupancy_grid(grid: Grid, occupied: np.ndarray, seen: np.ndarray, time_ns: int) -> Any:
    """Return a believed map as `nav_msgs/msg/OccupancyGrid`.

    Args:
        grid: planning grid, whose fine cells the map has.
        occupied: `(fine_size, fine_size)` bool, cells that count as occupied.
        seen: `(fine_size, fine_size)` bool, cells that were seen.
        time_ns: time of the map, nanoseconds.
    """
    corner = _new("geometry_msgs/msg/Point", x=-grid.arena_m / 2, y=-grid.arena_m / 2, z=0.0)
    level = _new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    about = _new(
        "nav_msgs/msg/MapMetaData",
        map_load_time=_time(time_ns),
        resolution=grid.fine_m,
        width=grid.fine_size,
        height=grid.fine_size,
        origin=_new("geometry_msgs/msg/Pose", position=corner, orientation=level),
    )
    cells = np.where(occupied, OCCUPIED, np.where(seen, FREE, UNKNOWN)).astype(np.int8).ravel()
    return _new(
        "nav_msgs/msg/OccupancyGrid",
        header=_new("std_msgs/msg/Header", stamp=_time(time_ns), frame_id=FRAME),
        info=about,
        data=cells,
    )


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
    return _new("builtin_interfaces/msg/Time", sec=time_ns // NS_PER_S, nanosec=time_ns % NS_PER_S)
