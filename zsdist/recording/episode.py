"""Recording of one driven episode into a file that is there only when it is complete, and reading it back."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from zsdist.common import atomic_files
from zsdist.errors import DataError
from zsdist.planning.grid import Grid
from zsdist.recording import log, messages
from zsdist.recording.recorded_set import ABOUT
from zsdist.ros2 import messages as ros
from zsdist.types import Pose, Trajectory
from zsdist.wire import codec
from zsdist.wire.messages import Push

RECORDED = "recorded"  # name under which recorded transitions are pushed, in the place of an actor's


@dataclass(frozen=True)
class DriveState:
    """State of a drive at a decision or at its end.

    Attributes:
        time_s: simulated time since the start.
        picture: `(h, w, 3)` uint8, RGB.
        pose: pose of the car.
        occupied: `(fine_size, fine_size)` bool, believed map; None for a driver without one.
        seen: `(fine_size, fine_size)` bool, cells of it that were seen; None with `occupied`.
    """

    time_s: float
    picture: np.ndarray
    pose: Pose
    occupied: np.ndarray | None = None
    seen: np.ndarray | None = None


class EpisodeFile:
    """File of one episode, as it is driven; `keep` gives it its name, and without that nothing of it stays.

    Args:
        path: file to make.
        grid: planning grid, for the believed map.
        form: form of the pictures, `jpeg` or `png`.
        about: texts that concern the whole file.
        goal: `(x_m, y_m)` of the goal.
    """

    def __init__(self, path: Path, grid: Grid, form: str, about: Mapping[str, str], goal: tuple[float, float]) -> None:
        self._path, self._partial = path, path.with_name(f".{path.name}.partial")
        self._grid, self._form = grid, form
        self._log = log.Log(self._partial)
        self._log.describe(ABOUT, about)
        self._log.write_encoded(messages.GOAL, ros.POSE_STAMPED.name, ros.encode_goal(goal, messages.FRAME), 0)
        self._pending: tuple[DriveState, int] | None = None  # sight and action whose result is not known yet
        self._number, self._last_ns = 0, 0
        self._counts: dict[str, int] = {}
        self._sequences: dict[str, int] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._log.close()
        finally:
            self._partial.unlink(missing_ok=True)  # after `keep` it has another name

    def act(self, sight: DriveState, action: int) -> None:
        """Write a decision; `result` follows once it was carried out."""
        self._see(sight)
        self._pending = (sight, action)

    def result(self, after: DriveState, rewards: tuple[float, float, float], ended: str = "") -> None:
        """Write the result of the last decision: its mean speeds and its rewards.

        Args:
            after: state after it.
            rewards: the paper's terms for distance, safety and goal.
            ended: `terminated` or `truncated` where it ended the episode; else empty.
        """
        assert self._pending is not None, "a decision comes before its result"
        before, action = self._pending
        time_ns = _ns(before.time_s)
        velocity = ros.encode_twist(_mean_velocity(before, after))
        self._log.write_encoded(messages.COMMANDS, ros.TWIST.name, velocity, time_ns)
        self._log.write(messages.STEPS, messages.step(self._number, action, rewards, ended, time_ns), time_ns)
        self._number += 1
        self._pending = None

    def end(self, sight: DriveState) -> None:
        """Write the state in which the episode ended."""
        self._see(sight)

    def transitions(self, trajectories: Sequence[Trajectory], time_s: float) -> None:
        """Write finished trajectories."""
        for trajectory in trajectories:
            level, count = trajectory.level, len(trajectory)
            total = self._counts[level] = self._counts.get(level, 0) + count
            sequence = self._sequences[level] = self._sequences.get(level, -1) + 1
            frame = codec.encode(Push(level, RECORDED, 0, sequence, total, False, (trajectory,)))
            message = messages.transitions(level.value, count, frame)
            self._log.write(messages.TRANSITIONS, message, _ns(time_s))

    def keep(self, result: Mapping[str, Any]) -> None:
        """Write how the episode ended, and give the file its name once it is on the disk."""
        self._log.write(messages.EPISODE, messages.text(json.dumps(result, allow_nan=False)), self._last_ns)
        self._log.close()
        atomic_files.sync(self._partial)
        self._partial.replace(self._path)
        atomic_files.sync_folder(self._path.parent)

    def _see(self, sight: DriveState) -> None:
        time_ns = self._last_ns = _ns(sight.time_s)
        picture = ros.CompressedPicture(time_ns, messages.compress(sight.picture, self._form), format=self._form)
        self._log.write_encoded(messages.PICTURES, ros.COMPRESSED_IMAGE.name, ros.encode_picture(picture), time_ns)
        reading = ros.OdometryReading(time_ns, sight.pose, ros.Velocity(0.0, 0.0))
        self._log.write_encoded(messages.ODOMETRY, ros.ODOMETRY.name, ros.encode_odometry(reading), time_ns)
        if sight.occupied is not None and sight.seen is not None:
            grid = messages.occupancy_grid(self._grid, sight.occupied, sight.seen, time_ns)
            self._log.write(messages.BELIEF, grid, time_ns)


@dataclass(frozen=True)
class RecordedEpisode:
    """Recorded episode of `n` steps.

    Attributes:
        pictures: `(n + 1, h, w, 3)` uint8, RGB.
        poses: `(n + 1, 3)` float64, metres and radians.
        goal: `(x_m, y_m)` of the goal.
        actions: `(n,)` int64.
        rewards: `(n, 3)` float64, the paper's terms for distance, safety and goal.
        terminated: `(n,)` bool.
        truncated: `(n,)` bool.
        result: how the episode ended, as in an evaluation's `per_scene`.
    """

    pictures: np.ndarray
    poses: np.ndarray
    goal: tuple[float, float]
    actions: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    result: dict[str, Any]


def read_episode(path: Path) -> RecordedEpisode:
    """Read an episode.

    Raises:
        DataError: the file is damaged, or not an episode of a recorded set.
    """
    pictures, poses, steps, goal, result = [], [], [], None, None
    wanted = (messages.PICTURES, messages.ODOMETRY, messages.STEPS, messages.GOAL, messages.EPISODE)
    for logged in log.read(path, wanted):
        match logged.topic:
            case messages.PICTURES:
                pictures.append(messages.decompress(ros.decode_picture(logged.content).data))
            case messages.ODOMETRY:
                poses.append(ros.decode_odometry(logged.content).pose)
            case messages.STEPS:
                steps.append(logged.decoded())
            case messages.GOAL:
                goal = ros.decode_goal(logged.content).position_m
            case messages.EPISODE:
                result = json.loads(logged.decoded().data)
    if goal is None or result is None or not len(pictures) == len(poses) == len(steps) + 1:
        raise DataError(
            f"{path} is not a finished episode: {len(pictures)} pictures, {len(poses)} poses and {len(steps)} steps; "
            "allowed is a file of a recorded set"
        )
    return RecordedEpisode(
        pictures=np.stack(pictures),
        poses=np.array(poses, np.float64),
        goal=goal,
        actions=np.array([step.action for step in steps], np.int64),
        rewards=np.array([[step.reward_distance, step.reward_safety, step.reward_goal] for step in steps]),
        terminated=np.array([step.terminated for step in steps]),
        truncated=np.array([step.truncated for step in steps]),
        result=result,
    )


def _ns(time_s: float) -> int:
    return round(time_s * ros.NS_PER_S)


def _mean_velocity(before: DriveState, after: DriveState) -> ros.Velocity:
    """Return the mean speed along the car's heading and the mean turn rate between two states."""
    elapsed_s = max(after.time_s - before.time_s, 1e-9)
    moved_m = math.hypot(after.pose.x_m - before.pose.x_m, after.pose.y_m - before.pose.y_m)
    turned = math.remainder(after.pose.heading_rad - before.pose.heading_rad, math.tau)
    return ros.Velocity(moved_m / elapsed_s, turned / elapsed_s)
