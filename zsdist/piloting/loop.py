"""Loop of a driver: hears, checks 20 times a second whether the robot may move, and commands it."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from zsdist.errors import DecodeError, RunError
from zsdist.piloting.arena import ArenaFrame
from zsdist.piloting.journey import ComingDecision, Glimpse, Journey, JourneyPhase, TimedPose
from zsdist.piloting.limits import STANDSTILL, MotionLimits
from zsdist.piloting.senses import DriveClock, HostClocks, Senses
from zsdist.planning.grid import Grid
from zsdist.ros2.messages import NS_PER_S, Velocity
from zsdist.types import Pose

CHECK_S = 0.05
FRESH_AGAIN_S = 0.3  # everything has to be well for so long before the robot moves again
PREDICT_MOST_S = 0.3
ZEROS = 5  # commands of zero at the end, lest one is lost
ZEROS_EVERY_S = 0.02


class Commander(Protocol):
    """Way to the robot."""

    def send(self, velocity: Velocity) -> None:
        """Send a velocity."""

    def rivals(self) -> list[str]:
        """Return the names of others that can command the robot."""

    @property
    def connected(self) -> bool:
        """True while the router is connected."""


class ReplanningPolicy(Protocol):
    """Part of `zsdist.runtime.runner.BundleRunner` that is used, behind a thread."""

    def begin(self, pose: Pose, goal_m: tuple[float, float], centre: tuple[float, float]) -> None:
        """Forget the map, and begin at a pose; `centre` is that of the arena, in the odometry's frame."""

    def set_goal(self, goal_m: tuple[float, float]) -> None:
        """Take another goal and keep the map."""

    def decide(self, picture: np.ndarray, pose: Pose) -> ComingDecision:
        """Return the future decision on a picture and its pose."""


@dataclass(frozen=True)
class DriveSettings:
    """Settings of a drive.

    Attributes:
        goal: goal in the odometry's frame; None: goals come from their topic, and the drive goes on after each.
        centre: centre of the arena in the odometry's frame; None: it is chosen.
        armed: whether the robot is commanded at all.
        rate_hz: commands a second.
        stop_after_s: age of pictures, poses, router or switch from which the robot stops.
        dead_man: whether a dead man's switch is required.
        give_up_s: seconds after which a drive that cannot go on ends.
        limits: limits of the velocities.
    """

    goal: tuple[float, float] | None
    centre: tuple[float, float] | None = None
    armed: bool = False
    rate_hz: float = 10.0
    stop_after_s: float = 0.5
    dead_man: bool = False
    give_up_s: float = 30.0
    limits: MotionLimits = field(default_factory=MotionLimits)


class DriveLoop:
    """Loop of one drive; `run` returns when it is over, and `stop` commands zero in any case.

    Args:
        settings: settings of the drive.
        policy: policy that decides.
        grid: planning grid of the policy.
        senses: what is heard.
        clock: time of the drive.
        commander: way to the robot.
        say: called with lines for the user.
        monotonic: monotonic clock of this machine, in seconds.
        wall: time of day, in seconds.

    Attributes:
        wake: set by what arrives.
        outcome: `arrived` or `stopped`; empty before the end.
        reason: why it has ended.
        stops: times at which the robot was stopped on the way, why, and for how long.
    """

    def __init__(
        self,
        settings: DriveSettings,
        policy: ReplanningPolicy,
        grid: Grid,
        senses: Senses,
        clock: DriveClock,
        commander: Commander,
        say: Callable[[str], None],
        *,
        wake: threading.Event,
        monotonic: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
    ) -> None:
        self._settings, self._policy, self._grid = settings, policy, grid
        self._senses, self._clock, self._commander = senses, clock, commander
        self._say, self._monotonic = say, monotonic
        self._hosts = HostClocks(monotonic, wall)
        self.wake = wake
        self.outcome = self.reason = ""
        self.stops: list[dict[str, Any]] = []
        self.commands = 0
        self.velocity = STANDSTILL
        self._frame: ArenaFrame | None = None
        self._journey: Journey | None = None
        self._goal = settings.goal
        self._said_s = monotonic()
        self._control_s = self._zero_s = -math.inf
        self._fault: str | None = "nothing heard yet"
        self._fault_since_s = monotonic()
        self._fault_over_s: float | None = None
        self._started_s: float | None = None
        self._left_out, self._left_out_s = "", math.inf

    def run(self) -> None:
        """Drive until the goal is reached or the drive cannot go on."""
        while not self.outcome:
            self.wake.wait(CHECK_S)
            self.wake.clear()
            self.step()

    def stop(self) -> None:
        """Command zero, several times."""
        if self._settings.armed:
            for _ in range(ZEROS):
                self._command(STANDSTILL)
                time.sleep(ZEROS_EVERY_S)

    def step(self) -> None:
        """Take what has arrived, check, and command."""
        mono_s = self._monotonic()
        moved = self._senses.receive()
        now_s = self._clock.now_s()
        if moved:
            self._place()
        self._hear_goal()
        if rivals := self._settings.armed and self._commander.rivals():
            self._end("stopped", f"another commander is on the topic: {', '.join(rivals)}")
        elif self._senses.jumped is not None and self._journey is not None:
            self._end("stopped", self._senses.jumped)
        if self.outcome:
            self._command(STANDSTILL)
            return
        self._check(now_s, mono_s)
        every_s = 1 / self._settings.rate_hz - 1e-6
        if self._fault is not None:
            if mono_s - self._zero_s >= every_s:  # also while a simulated clock stands still
                self._stand(mono_s)
        elif now_s - self._control_s >= every_s or now_s < self._control_s:
            self._control_s = now_s
            self._control(now_s)
        if mono_s - self._said_s >= 1.0:
            self._said_s = mono_s
            self._say(self.line(now_s))

    def line(self, now_s: float) -> str:
        """Return one line about the drive."""
        journey = self._journey
        if journey is None or self._goal is None or self._fault is not None:
            return f"{self._elapsed_s():7.1f} s  standing: {self._fault or 'no goal yet'}"
        last, decision = journey.track.last, journey.decision
        assert last is not None and self._frame is not None, "the drive has begun"
        goal = self._frame.point(self._goal)
        action = "" if decision is None or decision.action is None else f" {decision.action.name}"
        odometry = self._senses.odometry
        assert odometry is not None, "the drive has begun"
        x_m, y_m, heading = odometry.pose
        return (
            f"{self._elapsed_s():7.1f} s  {journey.phase} {journey.actions}{action}  at ({x_m:.2f}, {y_m:.2f}) "
            f"{math.degrees(heading):.0f} deg  {self.velocity.speed_mps:.2f} m/s "
            f"{math.degrees(self.velocity.turn_rad_s):+.0f} deg/s  goal {math.dist(goal, last.pose[:2]):.1f} m  "
            f"picture {self._senses.pictures.age_s(now_s):.2f} s, odometry {self._senses.poses.age_s(now_s):.2f} s old"
        )

    def result(self) -> dict[str, Any]:
        """Return the result of the drive, as JSON has it."""
        journey, odometry = self._journey, self._senses.odometry
        found: dict[str, Any] = {
            "outcome": self.outcome or "stopped",
            "reason": self.reason,
            "armed": self._settings.armed,
            "actions": 0 if journey is None else journey.actions,
            "path_m": 0.0 if journey is None else round(journey.path_m, 3),
            "time_s": round(self._elapsed_s(), 3),
            "commands": self.commands,
            "stops": self.stops,
            "undecodable": self._senses.undecodable,
            "simulated_time": self._clock.simulated,
        }
        if self._goal is not None:
            found["goal"] = list(self._goal)
        if odometry is not None:
            found["pose"] = {
                "x_m": round(odometry.pose.x_m, 3),
                "y_m": round(odometry.pose.y_m, 3),
                "heading_deg": round(math.degrees(odometry.pose.heading_rad), 2),
            }
        if self._frame is not None:
            found["arena_centre"] = list(self._frame)
        return found

    def interrupted(self, by: str) -> None:
        """Note that a signal ends the drive."""
        self._end("stopped", by)

    def _elapsed_s(self) -> float:
        return 0.0 if self._started_s is None else max(self._clock.now_s() - self._started_s, 0.0)

    def _place(self) -> None:
        """Begin the drive where the robot stands, or follow it."""
        odometry = self._senses.odometry
        if odometry is None:
            return
        if self._journey is None or self._frame is None:
            if self._goal is None or self._fault is not None:
                return
            self._senses.begun = True
            try:
                self._frame = ArenaFrame.place(odometry.pose, self._goal, self._grid, self._settings.centre)
            except RunError as error:
                if self._settings.goal is not None:
                    raise
                self._goal = None
                self._say(f"goal left out: {error}")
                return
            self._policy.begin(self._frame.pose(odometry.pose), self._frame.point(self._goal), self._frame)
            self._journey = Journey(
                self._policy.decide, self._grid, self._settings.limits, carries_out=self._settings.armed
            )
            self._started_s = self._clock.now_s()
        self._journey.see_pose(TimedPose(odometry.time_ns / NS_PER_S, self._frame.pose(odometry.pose)))

    def _hear_goal(self) -> None:
        goal, odometry = self._senses.goal, self._senses.odometry
        if goal is None or odometry is None:
            return
        self._senses.goal = None
        if goal.frame.lstrip("/") not in ("", odometry.frame.lstrip("/")):
            self._say(f"a goal in frame {goal.frame!r} is left out; allowed is the odometry's frame {odometry.frame!r}")
            return
        if self._journey is not None and self._frame is not None:
            try:
                self._frame.check_goal(goal.position_m, self._grid)
            except RunError as error:
                self._say(f"goal left out: {error}")
                return
            self._policy.set_goal(self._frame.point(goal.position_m))
            self._journey.look_again()
        self._goal = goal.position_m
        self._say(f"new goal: ({self._goal[0]:.2f}, {self._goal[1]:.2f})")

    def _check(self, now_s: float, mono_s: float) -> None:
        """Stop the robot at a fault, and let it go on when all has been well for a while."""
        fault = self._fault_now(now_s, mono_s)
        if fault is not None:
            self._fault_over_s = None
            if self._fault is None:
                self._fault, self._fault_since_s = fault, mono_s
                self._stand(mono_s)
                self.stops.append({"time_s": round(self._elapsed_s(), 3), "reason": fault})
                self._say(f"{self._elapsed_s():7.1f} s  stop: {fault}")
            self._fault = fault
            if mono_s - self._fault_since_s > self._settings.give_up_s:
                self._end("stopped", f"{fault}; gave up after {self._settings.give_up_s:g} s")
        elif self._fault is not None:
            if self._fault_over_s is None:
                self._fault_over_s = mono_s
            if mono_s - self._fault_over_s >= FRESH_AGAIN_S:
                if self.stops:
                    self.stops[-1]["for_s"] = round(mono_s - self._fault_since_s, 3)
                    self._say(f"{self._elapsed_s():7.1f} s  going on: all is well again")
                self._fault = None

    def _fault_now(self, now_s: float, mono_s: float) -> str | None:
        senses, limit_s = self._senses, self._settings.stop_after_s
        faults = [
            None if self._commander.connected else "the router is gone",
            self._hosts.fault(limit_s),
            self._clock.fault(limit_s),
            senses.pictures.fault(now_s),
            senses.poses.fault(now_s),
            senses.lag_fault(limit_s),
            senses.dead_man_fault(mono_s, limit_s) if self._settings.dead_man else None,
        ]
        return next((fault for fault in faults if fault is not None), None)

    def _control(self, now_s: float) -> None:
        journey = self._journey
        if journey is None:
            return
        picture = self._senses.picture
        glimpse = None if picture is None else Glimpse(picture.time_s, picture.decoded)
        try:
            self._command(journey.control(now_s, glimpse, self._predicted(now_s)))
        except DecodeError as error:
            self._senses.picture = None
            self._senses.undecodable += 1
            self._command(STANDSTILL)
            self._leave_out(error)
        else:
            if journey.phase is JourneyPhase.DECIDE:
                self._left_out, self._left_out_s = "", math.inf
        if journey.phase is JourneyPhase.ARRIVED and self._settings.goal is None:
            if self._goal is not None:
                self._goal = None
                self._say(f"{self._elapsed_s():7.1f} s  the goal is reached; waiting for another one")
        elif journey.over:
            self._end("arrived" if journey.phase is JourneyPhase.ARRIVED else "stopped", journey.reason)

    def _leave_out(self, error: DecodeError) -> None:
        """Say once why pictures are left out, and end the drive where none has been any good for long."""
        mono_s = self._monotonic()
        if error.reason != self._left_out:
            self._say(f"{self._elapsed_s():7.1f} s  picture left out: {error}")
        self._left_out, self._left_out_s = error.reason, min(self._left_out_s, mono_s)
        if mono_s - self._left_out_s > self._settings.give_up_s:
            self._end("stopped", f"{error}; gave up after {self._settings.give_up_s:g} s")

    def _stand(self, mono_s: float) -> None:
        """Command zero, whatever the drive wants."""
        self._zero_s = mono_s
        if self._journey is not None:
            self._journey.hold()
            self._command(STANDSTILL)

    def _predicted(self, now_s: float) -> Pose | None:
        """Return where the robot is now, from its newest odometry and its age."""
        odometry = self._senses.odometry
        if odometry is None or self._frame is None:
            return None
        age_s = min(self._senses.poses.age_s(now_s), PREDICT_MOST_S)
        pose, velocity = self._frame.pose(odometry.pose), odometry.velocity
        middle = pose.heading_rad + velocity.turn_rad_s * age_s / 2
        way = velocity.speed_mps * age_s
        return Pose(
            pose.x_m + way * math.cos(middle),
            pose.y_m + way * math.sin(middle),
            math.remainder(pose.heading_rad + velocity.turn_rad_s * age_s, math.tau),
        )

    def _command(self, velocity: Velocity) -> None:
        self.velocity = velocity
        if self._settings.armed and self._journey is not None:
            self._commander.send(velocity)
            self.commands += 1

    def _end(self, outcome: str, reason: str) -> None:
        if not self.outcome:
            self.outcome, self.reason = outcome, reason
