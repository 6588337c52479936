"""Pilot that follows one action of the lattice by a stream of velocities, from the pose alone."""

import math
from enum import StrEnum
from typing import NamedTuple

from zsdist.piloting.limits import STANDSTILL, MotionLimits
from zsdist.ros2.messages import Velocity
from zsdist.types import Pose


class PilotGains(NamedTuple):
    """Constants of the pilot, for robots between a TurtleBot and the simulated car."""

    facing_rad: float = math.radians(3.0)  # an advance begins at this error of the heading
    aligned_rad: float = math.radians(2.5)  # the last turn ends at this error
    turn_rate_per_rad: float = 3.0  # turn rate per error of the heading, near the end of a turn
    turn_least_rad_s: float = math.radians(6.0)  # some robots do not turn at lower rates
    turn_share: float = 0.5  # share of the turn acceleration on which braking relies
    near_m: float = 0.03  # an advance ends this close to the target
    here_m: float = 0.08  # a target within this distance needs no advance
    brake_share: float = 0.6  # share of the acceleration on which braking relies
    creep_mps: float = 0.08  # least speed of an advance that has not ended
    look_ahead_m: float = 0.6  # least distance over which an offset from the line is corrected
    aim_most_rad: float = 0.35  # most angle towards the line
    steer_per_rad: float = 2.0  # turn rate per error of the heading, driving
    steer_most_rad_s: float = math.radians(40.0)
    astray_rad: float = math.radians(40.0)  # an advance that points elsewhere by more turns in place again


class PilotPhase(StrEnum):
    """Part of an action that is being followed."""

    TURN = "turn"  # in place, towards the line to the target
    ADVANCE = "advance"
    ALIGN = "align"  # in place, to the target's heading
    DONE = "done"


class Pilot:
    """Follower of one target pose: turn in place, advance along the target's heading, turn to it exactly.

    Pure: it reads no clock. Call `follow` with each control step.

    Args:
        target: pose in which the action ends.
        advance: whether it advances; else the robot turns in place, wherever it stands.
        limits: limits of the velocities.
        along_target: whether the line of the advance has the target's heading, as in actions of the lattice; else it
            leads straight from where the robot is to the target.
        gains: constants.

    Attributes:
        target: pose in which the action ends.
        phase: part of the action that is being followed.
    """

    def __init__(
        self,
        target: Pose,
        advance: bool,
        limits: MotionLimits,
        *,
        along_target: bool = True,
        gains: PilotGains = PilotGains(),  # noqa: B008  # a constant
    ) -> None:
        self.target = target
        self.phase = PilotPhase.TURN if advance else PilotPhase.ALIGN
        self._limits, self._gains = limits, gains
        self._line_rad: float | None = target.heading_rad if along_target else None
        self._before = STANDSTILL

    @property
    def done(self) -> bool:
        """True once the robot has been brought to the target; it may still roll out."""
        return self.phase is PilotPhase.DONE

    def halt(self) -> None:
        """Note that the robot was commanded to stop at once: the next velocity begins at zero."""
        self._before = STANDSTILL

    def follow(self, pose: Pose, step_s: float) -> Velocity:
        """Return the velocity to command now, within the limits.

        Args:
            pose: present pose of the robot; where it is not finite, the robot brakes.
            step_s: seconds since the last call.
        """
        wanted = self._wanted(pose) if all(map(math.isfinite, pose)) else STANDSTILL
        self._before = self._limits.apply(wanted, self._before, step_s)
        return self._before

    def _wanted(self, pose: Pose) -> Velocity:
        line = self._line(pose)
        east, north = self.target.x_m - pose.x_m, self.target.y_m - pose.y_m
        ahead = east * math.cos(line) + north * math.sin(line)
        aside = north * math.cos(line) - east * math.sin(line)
        gains = self._gains
        bend = _clip(math.atan2(aside, max(ahead, gains.look_ahead_m)), gains.aim_most_rad)
        aim = math.remainder(line + bend - pose.heading_rad, math.tau)
        if self.phase is PilotPhase.TURN:
            if ahead < gains.here_m:
                self.phase = PilotPhase.ALIGN
            elif abs(aim) <= gains.facing_rad and self._is_slow():
                self.phase = PilotPhase.ADVANCE
            else:
                return self._turn(aim)
        if self.phase is PilotPhase.ADVANCE:
            if ahead <= gains.near_m:
                self.phase = PilotPhase.ALIGN
            elif abs(aim) > gains.astray_rad:
                self.phase = PilotPhase.TURN
                return STANDSTILL
            else:
                return self._advance(ahead, aim)
        turn = math.remainder(self.target.heading_rad - pose.heading_rad, math.tau)
        if self.phase is PilotPhase.ALIGN and abs(turn) <= gains.aligned_rad and self._is_slow():
            self.phase = PilotPhase.DONE
        return STANDSTILL if self.phase is PilotPhase.DONE else self._turn(turn)

    def _line(self, pose: Pose) -> float:
        if self._line_rad is None:
            self._line_rad = math.atan2(self.target.y_m - pose.y_m, self.target.x_m - pose.x_m)
        return self._line_rad

    def _is_slow(self) -> bool:
        """Return whether the last command was so slow that the next part may begin."""
        return self._before.speed_mps <= self._gains.creep_mps and abs(self._before.turn_rad_s) <= 0.35

    def _turn(self, error_rad: float) -> Velocity:
        """Return a turn in place; no turn before the robot stands, since it would leave its place."""
        if self._before.speed_mps > 0.0:
            return STANDSTILL
        gains, limits = self._gains, self._limits
        size = abs(error_rad)
        braking = math.sqrt(2 * gains.turn_share * limits.turn_acceleration_rad_s2 * size)
        rate = max(min(gains.turn_rate_per_rad * size, braking), gains.turn_least_rad_s)
        if size <= gains.aligned_rad:
            rate = 0.0
        return Velocity(0.0, math.copysign(rate, error_rad))

    def _advance(self, ahead_m: float, aim_rad: float) -> Velocity:
        gains, limits = self._gains, self._limits
        left_m = max(ahead_m - gains.near_m, 0.0)
        speed = max(math.sqrt(2 * gains.brake_share * limits.acceleration_mps2 * left_m), gains.creep_mps)
        speed *= max(0.0, math.cos(2 * aim_rad))  # slower the farther it points from the line
        return Velocity(max(speed, gains.creep_mps), _clip(gains.steer_per_rad * aim_rad, gains.steer_most_rad_s))


def _clip(value: float, most: float) -> float:
    return max(-most, min(most, value))
