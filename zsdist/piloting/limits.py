"""Limits of the velocities that a robot is commanded."""

import math
from dataclasses import dataclass

from zsdist.ros2.messages import Velocity

STANDSTILL = Velocity(0.0, 0.0)
LONGEST_STEP_S = 0.2  # a longer time between two commands allows no larger change of the velocity


@dataclass(frozen=True)
class MotionLimits:
    """Most that a robot is commanded. It is never commanded backward.

    Attributes:
        speed_mps: speed.
        turn_rad_s: turn rate, in either direction.
        acceleration_mps2: change of the speed per second, of speeding up and of braking.
        turn_acceleration_rad_s2: change of the turn rate per second.
    """

    speed_mps: float = 1.0
    turn_rad_s: float = math.radians(90.0)
    acceleration_mps2: float = 1.5
    turn_acceleration_rad_s2: float = math.radians(360.0)

    def apply(self, wanted: Velocity, before: Velocity, step_s: float) -> Velocity:
        """Return the wanted velocity, or the nearest that the limits allow.

        Args:
            wanted: wanted velocity; where it is not finite, it is zero.
            before: velocity of the last command.
            step_s: seconds since the last command.
        """
        step_s = min(max(step_s, 0.0), LONGEST_STEP_S) if math.isfinite(step_s) else 0.0
        speed = _towards(wanted.speed_mps, before.speed_mps, self.acceleration_mps2 * step_s, 0.0, self.speed_mps)
        turn = _towards(
            wanted.turn_rad_s,
            before.turn_rad_s,
            self.turn_acceleration_rad_s2 * step_s,
            -self.turn_rad_s,
            self.turn_rad_s,
        )
        return Velocity(speed, turn)


def _towards(wanted: float, before: float, change: float, least: float, most: float) -> float:
    """Return the value within both ranges nearest to the wanted one; the fixed range wins over that of the change."""
    if not math.isfinite(wanted):
        wanted = 0.0
    changed = min(max(wanted, before - change), before + change)
    return min(max(changed, least), most)
