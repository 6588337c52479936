"""Course of a drive: look, decide, follow the action, look again; pure apart from the function that decides."""

import math
from collections import deque
from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple, Protocol

import numpy as np

from zsdist.piloting.limits import STANDSTILL, MotionLimits
from zsdist.piloting.pilot import Pilot
from zsdist.planning.footprint import ADVANCES
from zsdist.planning.grid import Grid
from zsdist.ros2.messages import Velocity
from zsdist.types import Action, Pose

ON_LATTICE_M = 0.10  # a start within this distance of a lattice state, and this angle, needs no drive onto it
ON_LATTICE_RAD = math.radians(5.0)
STANDS_WITHIN_M = 0.01  # a robot that moves less in `STILL_S` stands
STANDS_WITHIN_RAD = math.radians(1.0)
STILL_S = 0.15
STANDS_AFTER_S = 1.0  # and in any case so long after it was commanded to stand
NO_PROGRESS_S = 20.0  # an action that takes longer is not being carried out
LOOKS_WITHOUT_WAY = 10  # a way may open again: people walk on
LOOK_AGAIN_S = 1.0


class PolicyDecision(Protocol):
    """Part of `zsdist.runtime.runner.RunnerDecision` that is used."""

    @property
    def action(self) -> Action | None:
        """Action to take; None: the goal is reached, or there is no way."""

    @property
    def target(self) -> Pose | None:
        """Pose at which the action ends."""

    @property
    def arrived(self) -> bool:
        """Return whether the goal is reached."""

    @property
    def no_way(self) -> str | None:
        """Reason for which there is no action."""


class ComingDecision(Protocol):
    """Part of a future that is used."""

    def done(self) -> bool:
        """Return whether the decision has been made."""

    def result(self) -> PolicyDecision:
        """Return the decision, or raise the error of making it."""


Decide = Callable[[np.ndarray, Pose], ComingDecision]


class JourneyPhase(StrEnum):
    """Part of a drive."""

    ENTER = "entering the lattice"
    SETTLE = "coming to rest"
    LOOK = "looking"
    DECIDE = "deciding"
    MOVE = "moving"
    ARRIVED = "arrived"
    ENDED = "ended"


class TimedPose(NamedTuple):
    """Pose in the frame of the arena, and the robot's time of it in seconds."""

    time_s: float
    pose: Pose


class Glimpse(NamedTuple):
    """Picture `(h, w, 3)` uint8 RGB, and the robot's time of it in seconds."""

    time_s: float
    picture: Callable[[], np.ndarray]


class Track:
    """Last poses of the robot, in the order of their times."""

    def __init__(self, memory_s: float = 3.0) -> None:
        self._memory_s = memory_s
        self._poses: deque[TimedPose] = deque()

    def add(self, timed: TimedPose) -> None:
        """Add a pose; one that is not newer than the last begins the track anew."""
        if self._poses and timed.time_s <= self._poses[-1].time_s:
            self._poses.clear()
        self._poses.append(timed)
        while timed.time_s - self._poses[0].time_s > self._memory_s:
            self._poses.popleft()

    @property
    def last(self) -> TimedPose | None:
        """Newest pose."""
        return self._poses[-1] if self._poses else None

    def at(self, time_s: float) -> Pose | None:
        """Return the pose at a time, interpolated; the nearest one where the track does not reach; None if empty."""
        later = None
        for timed in reversed(self._poses):
            if timed.time_s <= time_s:
                return timed.pose if later is None else _between(timed, later, time_s)
            later = timed
        return None if later is None else later.pose

    def stands_since(self, since_s: float) -> bool:
        """Return whether the robot has not moved for `STILL_S`, all of it after a time."""
        if not self._poses or self._poses[-1].time_s - since_s < STILL_S:
            return False
        now, then = self._poses[-1].pose, self.at(self._poses[-1].time_s - STILL_S)
        assert then is not None, "the track is not empty"
        turned = math.remainder(now.heading_rad - then.heading_rad, math.tau)
        return math.dist(now[:2], then[:2]) < STANDS_WITHIN_M and abs(turned) < STANDS_WITHIN_RAD


class Journey:
    """Drive to a goal on the lattice of a policy.

    Call `control` at the rate of commands. It never blocks: `decide` returns a future.

    Args:
        decide: function that takes a picture and its pose, and returns the future decision.
        grid: planning grid.
        limits: limits of the velocities.
        carries_out: whether the velocities are sent to a robot; without it, decisions are repeated where it stands.

    Attributes:
        phase: part of the drive.
        decision: last decision.
        actions: number of actions so far.
        reason: why the drive has ended; empty before.
        path_m: length of the driven path.
    """

    def __init__(self, decide: Decide, grid: Grid, limits: MotionLimits, *, carries_out: bool = True) -> None:
        self._decide, self._grid, self._limits = decide, grid, limits
        self._carries_out = carries_out
        self.track = Track()
        self.phase = JourneyPhase.ENTER
        self.decision: PolicyDecision | None = None
        self.actions = 0
        self.reason = ""
        self.path_m = 0.0
        self._measured: Pose | None = None
        self._pilot: Pilot | None = None
        self._future: ComingDecision | None = None
        self._looks_left = LOOKS_WITHOUT_WAY
        self._since_s = math.nan  # the robot's time at which the phase began
        self._last_s: float | None = None  # time of the last control step

    @property
    def over(self) -> bool:
        """True once the drive has ended, at the goal or not."""
        return self.phase in (JourneyPhase.ARRIVED, JourneyPhase.ENDED)

    def see_pose(self, timed: TimedPose) -> None:
        """Note a pose of the robot."""
        self.track.add(timed)
        if self._measured is None:
            self._measured = timed.pose
        moved = math.dist(self._measured[:2], timed.pose[:2])
        if moved > STANDS_WITHIN_M:  # the noise of a standing robot is no path
            self.path_m += moved
            self._measured = timed.pose

    def hold(self) -> None:
        """Note that the robot is commanded to stand now, whatever the drive wants; it goes on from rest."""
        self._last_s = None
        last = self.track.last
        if last is not None:
            self._since_s = last.time_s
        if self._pilot is not None:
            self._pilot.halt()

    def look_again(self) -> None:
        """Decide again, from where the robot stands: after a new goal. An action that is under way is ended first."""
        if self.phase is not JourneyPhase.MOVE and self.phase is not JourneyPhase.ENTER:
            self._enter(JourneyPhase.SETTLE)

    def control(self, now_s: float, glimpse: Glimpse | None, pose: Pose | None = None) -> Velocity:
        """Return the velocity to command now.

        Args:
            now_s: time of the control step, by the clock that paces commands.
            glimpse: newest picture.
            pose: present pose, predicted from the newest one; None: the newest one.
        """
        step_s = 0.0 if self._last_s is None else now_s - self._last_s
        self._last_s = now_s
        last = self.track.last
        if last is None or self.over:
            return STANDSTILL
        if math.isnan(self._since_s):
            self._since_s = last.time_s
        here = last.pose if pose is None else pose
        if self.phase is JourneyPhase.ENTER:
            self._begin_entry(last)
        if self.phase is JourneyPhase.SETTLE and self._stands(last):
            self._enter(JourneyPhase.LOOK)
            self._since_s -= STILL_S  # it has stood for so long
        if self.phase is JourneyPhase.LOOK and glimpse is not None and glimpse.time_s >= self._since_s:
            seen_from = self.track.at(glimpse.time_s)
            assert seen_from is not None, "there is a pose"
            self._future = self._decide(glimpse.picture(), seen_from)
            self._enter(JourneyPhase.DECIDE)
        if self.phase is JourneyPhase.DECIDE and self._future is not None and self._future.done():
            self._take(self._future.result())
        if self._pilot is None or self.phase not in (JourneyPhase.MOVE, JourneyPhase.ENTER):
            return STANDSTILL
        return self._follow(self._pilot, here, step_s, last)

    def _begin_entry(self, last: TimedPose) -> None:
        if self._pilot is not None:
            return
        target = self._grid.pose(self._grid.lattice_state(last.pose))
        off_m = math.dist(target[:2], last.pose[:2])
        off_rad = abs(math.remainder(target.heading_rad - last.pose.heading_rad, math.tau))
        if (off_m <= ON_LATTICE_M and off_rad <= ON_LATTICE_RAD) or not self._carries_out:
            self._enter(JourneyPhase.SETTLE)
        else:
            self._pilot = Pilot(target, off_m > ON_LATTICE_M, self._limits, along_target=False)

    def _stands(self, last: TimedPose) -> bool:
        return self.track.stands_since(self._since_s) or last.time_s - self._since_s >= STANDS_AFTER_S

    def _take(self, decision: PolicyDecision) -> None:
        self.decision, self._future = decision, None
        if decision.arrived:
            self._enter(JourneyPhase.ARRIVED)
            self.reason = "the goal is reached"
        elif decision.no_way is not None or decision.action is None or decision.target is None:
            self._looks_left -= 1
            if not self._looks_left or decision.action is None:
                self._end(decision.no_way or "the policy has no action")
            else:
                self._enter(JourneyPhase.LOOK)
                self._since_s += LOOK_AGAIN_S
        else:
            self._looks_left = LOOKS_WITHOUT_WAY
            self.actions += self._carries_out
            self._pilot = Pilot(decision.target, bool(ADVANCES[decision.action]), self._limits)
            self._enter(JourneyPhase.MOVE)

    def _follow(self, pilot: Pilot, here: Pose, step_s: float, last: TimedPose) -> Velocity:
        velocity = pilot.follow(here, step_s)
        waited_s = last.time_s - self._since_s
        if (pilot.done and velocity == STANDSTILL) or (not self._carries_out and waited_s > STANDS_AFTER_S):
            self._pilot = None
            self._enter(JourneyPhase.SETTLE)
        elif waited_s > NO_PROGRESS_S:
            velocity, off_m = STANDSTILL, math.dist(here[:2], pilot.target[:2])
            self._end(
                f"the robot does not follow: after {waited_s:.0f} s it is {off_m:.2f} m from where an action ends"
            )
        return velocity

    def _end(self, reason: str) -> None:
        self._enter(JourneyPhase.ENDED)
        self.reason = reason

    def _enter(self, phase: JourneyPhase) -> None:
        self.phase = phase
        last = self.track.last
        if last is not None:
            self._since_s = last.time_s


def _between(first: TimedPose, second: TimedPose, time_s: float) -> Pose:
    share = (time_s - first.time_s) / (second.time_s - first.time_s)
    turn = math.remainder(second.pose.heading_rad - first.pose.heading_rad, math.tau)
    return Pose(
        first.pose.x_m + share * (second.pose.x_m - first.pose.x_m),
        first.pose.y_m + share * (second.pose.y_m - first.pose.y_m),
        math.remainder(first.pose.heading_rad + share * turn, math.tau),
    )
