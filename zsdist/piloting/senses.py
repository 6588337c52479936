"""Senses of a driver: newest pictures, odometry, goals, the dead man's switch, the clock, and other commanders."""

import math
from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from zsdist.errors import DecodeError
from zsdist.piloting.streams import LEAST_JUMP_S, Freshness
from zsdist.ros2 import messages
from zsdist.ros2.messages import NS_PER_S, CompressedPicture, OdometryReading
from zsdist.ros2.node import NewestMessage, Received

FASTEST_MPS = 8.0  # an odometry that moves faster has jumped
JUMP_M = 0.5
JUMP_RAD = math.radians(60.0)
Record = Callable[[str, bytes], None]


class DriveClock:
    """Time of a drive in seconds: this machine's monotonic clock, or the topic `/clock` once it has ticked."""

    def __init__(self, monotonic: Callable[[], float]) -> None:
        self._monotonic = monotonic
        self._simulated_s: float | None = None
        self._ticked_s = 0.0
        self._jump: str | None = None

    @property
    def simulated(self) -> bool:
        """Return whether the topic `/clock` gives the time."""
        return self._simulated_s is not None

    def tick(self, time_ns: int) -> None:
        """Note a message of `/clock`; from the first one on they give the time."""
        time_s = time_ns / NS_PER_S
        if self._simulated_s is not None and not -0.001 < time_s - self._simulated_s < 1.0:
            self._jump = f"/clock jumped by {time_s - self._simulated_s:+.1f} s"
        self._simulated_s, self._ticked_s = time_s, self._monotonic()

    def now_s(self) -> float:
        """Return the time of the drive."""
        return self._monotonic() if self._simulated_s is None else self._simulated_s

    def fault(self, stop_after_s: float) -> str | None:
        """Return the reason for which the robot has to stop now; None if there is none. A jump is told once."""
        if self._jump is not None:
            jump, self._jump = self._jump, None
            return jump
        silent_s = self._monotonic() - self._ticked_s
        if self._simulated_s is not None and silent_s > stop_after_s:
            return f"/clock stands still for {silent_s:.1f} s"
        return None


class HostClocks:
    """Clocks of this machine: whether the time of day jumped, and whether this program was stopped."""

    def __init__(self, monotonic: Callable[[], float], wall: Callable[[], float]) -> None:
        self._monotonic, self._wall = monotonic, wall
        self._last = (monotonic(), wall())

    def fault(self, stop_after_s: float) -> str | None:
        """Return the reason for which the robot has to stop, from what happened since the last call."""
        before, self._last = self._last, (self._monotonic(), self._wall())
        passed_s, passed_wall_s = (now - then for now, then in zip(self._last, before, strict=True))
        if passed_s > stop_after_s:
            return f"this program stood still for {passed_s:.1f} s"
        if abs(passed_wall_s - passed_s) > stop_after_s:
            return f"the clock of this machine jumped by {passed_wall_s - passed_s:+.1f} s"
        return None


class SeenPicture(NamedTuple):
    """Compressed picture, and the robot's time of it in seconds."""

    time_s: float
    content: CompressedPicture

    def decoded(self) -> np.ndarray:
        """Return the picture `(h, w, 3)` uint8, RGB; raise `DecodeError` if it is none."""
        picture = None
        if len(self.content.data):  # OpenCV fails on none
            picture = cv2.imdecode(self.content.data, cv2.IMREAD_COLOR)
        if picture is None:
            raise DecodeError(
                "picture", f"{len(self.content.data)} bytes of format {self.content.format!r} are no picture"
            )
        return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


class Senses:
    """Newest message of each topic, and how fresh the streams are.

    Args:
        clock: time of the drive.
        stop_after_s: age from which a stream stops the robot.
        wake: called by zenoh's threads with each message.
        record: called with the topic's name here and the bytes of each message that is used.

    Attributes:
        odometry: newest reading; None before the first.
        picture: newest picture; None before the first.
        goal: goal that came since it was last taken.
        undecodable: number of messages that were dropped since they are not what their topic promises.
        jumped: what is wrong with the odometry, once it has jumped.
        begun: whether the drive has begun; a `/clock` that ticks only then is not that of the robot, and is left out.
    """

    def __init__(
        self, clock: DriveClock, stop_after_s: float, wake: Callable[[], None], record: Record | None = None
    ) -> None:
        self.slots = {
            name: NewestMessage(wake) for name in ("odometry", "picture", "goal", "dead_man", "clock", "other")
        }
        self.pictures, self.poses = Freshness("pictures", stop_after_s), Freshness("odometry", stop_after_s)
        self.odometry: OdometryReading | None = None
        self.picture: SeenPicture | None = None
        self.goal: messages.GoalReading | None = None
        self.undecodable = 0
        self.jumped: str | None = None
        self.dead_man: tuple[bool, float] | None = None
        self.begun = False
        self._clock, self._record, self._stop_after_s = clock, record, stop_after_s
        self._unstamped = False

    def receive(self) -> bool:
        """Take what has arrived; return whether there is a new odometry."""
        before = self.odometry
        for name, use in (
            ("clock", self._tick),
            ("odometry", self._move),
            ("picture", self._see),
            ("goal", self._aim),
            ("dead_man", self._press),
        ):
            received = self.slots[name].take()
            if received is None:
                continue
            try:
                use(received)
            except DecodeError:
                self.undecodable += 1
                continue
            if self._record is not None:
                self._record(name, received.data)
        return self.odometry is not before

    def _tick(self, received: Received) -> None:
        time_ns = messages.decode_clock(received.data)
        if not self._clock.simulated:
            if self.begun:
                return
            self.pictures = Freshness("pictures", self._stop_after_s)
            self.poses = Freshness("odometry", self._stop_after_s)
        self._clock.tick(time_ns)

    def _move(self, received: Received) -> None:
        reading, before = messages.decode_odometry(received.data), self.odometry
        reading = reading._replace(time_ns=self._stamp_ns(reading.time_ns))
        if before is not None and before.time_ns < reading.time_ns:
            self._check_jump(before, reading)
        self._note(self.poses, reading.time_ns / NS_PER_S)
        self.odometry = reading

    def _stamp_ns(self, stamp_ns: int) -> int:
        """Return a stamp, or the time of arrival once a robot has sent pictures or odometry without one."""
        self._unstamped |= stamp_ns == 0
        return round(self._clock.now_s() * NS_PER_S) if self._unstamped else stamp_ns

    def _note(self, stream: Freshness, stamp_s: float) -> None:
        now_s = self._clock.now_s()
        if self._clock.simulated and 0 < stamp_s - now_s < LEAST_JUMP_S:
            now_s = stamp_s  # of the same clock, whose tick is still to come
        stream.seen(now_s, stamp_s)

    def _check_jump(self, before: OdometryReading, after: OdometryReading) -> None:
        passed_s = (after.time_ns - before.time_ns) / NS_PER_S
        moved_m = math.dist(before.pose[:2], after.pose[:2])
        turned = abs(math.remainder(after.pose.heading_rad - before.pose.heading_rad, math.tau))
        if moved_m > JUMP_M + FASTEST_MPS * passed_s:
            self.jumped = f"the odometry jumped by {moved_m:.1f} m"
        elif turned > JUMP_RAD + math.tau * passed_s:
            self.jumped = f"the odometry's heading jumped by {math.degrees(turned):.0f} degrees"

    def _see(self, received: Received) -> None:
        content = messages.decode_picture(received.data)
        time_s = self._stamp_ns(content.time_ns) / NS_PER_S
        self._note(self.pictures, time_s)
        self.picture = SeenPicture(time_s, content)

    def _aim(self, received: Received) -> None:
        self.goal = messages.decode_goal(received.data)

    def _press(self, received: Received) -> None:
        self.dead_man = (messages.decode_bool(received.data), received.arrived_s)

    def dead_man_fault(self, now_s: float, stop_after_s: float) -> str | None:
        """Return what is wrong with the dead man's switch at a time, `time.monotonic`; None where it is held."""
        if self.dead_man is None:
            return "the dead man's switch has not been heard"
        held, arrived_s = self.dead_man
        if not held:
            return "the dead man's switch is released"
        silent_s = now_s - arrived_s
        return None if silent_s <= stop_after_s else f"the dead man's switch is silent for {silent_s:.1f} s"

    def lag_fault(self, stop_after_s: float) -> str | None:
        """Return the reason to stop if pictures are stamped much earlier or later than the odometry; None if not."""
        if self.picture is None or self.odometry is None:
            return None
        lag_s = self.odometry.time_ns / NS_PER_S - self.picture.time_s
        if -stop_after_s <= lag_s <= 2 * stop_after_s:
            return None
        return f"pictures are stamped {abs(lag_s):.1f} s {'before' if lag_s > 0 else 'after'} the odometry"
