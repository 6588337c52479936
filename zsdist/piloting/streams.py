"""Streams of a robot's messages: how old their newest one is, how late they come, and whether their clock jumped."""

import math

MEMORY_S = 2.0  # a lower offset that lasts so long is a clock that was set back, and no delay
LEAST_JUMP_S = 0.5


class Freshness:
    """Age and delay of one stream, on an injected clock.

    The clock of the sender need not agree with ours: the least delay ever seen is taken as none. What arrives later
    than that is late by the difference.

    Args:
        name: name of the stream in reasons, such as `pictures`.
        stop_after_s: age from which the robot has to stop; also the least jump of a clock.
    """

    def __init__(self, name: str, stop_after_s: float) -> None:
        self.name = name
        self._limit_s = stop_after_s
        self._arrived_s: float | None = None
        self._offset_s = -math.inf  # greatest difference of sender's and own clock: that of the least delay
        self._late_s = 0.0
        self._late_since_s: float | None = None
        self._jump: str | None = None

    def seen(self, now_s: float, stamp_s: float) -> None:
        """Note a message.

        Args:
            now_s: time of arrival.
            stamp_s: time at which the robot stamped it, by the robot's clock.
        """
        offset = stamp_s - now_s
        first = self._arrived_s is None
        self._arrived_s = now_s
        if first:
            self._offset_s = offset
        elif offset > self._offset_s + max(self._limit_s, LEAST_JUMP_S):
            self._jumped(offset - self._offset_s)
            self._offset_s = offset
        self._offset_s = max(self._offset_s, offset)
        self._late_s = self._offset_s - offset
        if self._late_s <= self._limit_s:
            self._late_since_s = None
        elif self._late_since_s is None:
            self._late_since_s = now_s
        elif now_s - self._late_since_s > MEMORY_S:
            self._jumped(-self._late_s)
            self._offset_s, self._late_s, self._late_since_s = offset, 0.0, None

    def age_s(self, now_s: float) -> float:
        """Return the seconds since the newest message was made; infinite before the first."""
        return math.inf if self._arrived_s is None else max(now_s - self._arrived_s, 0.0) + self._late_s

    def fault(self, now_s: float) -> str | None:
        """Return the reason for which the robot has to stop now; None if there is none. A jump is told once."""
        if self._jump is not None:
            jump, self._jump = self._jump, None
            return jump
        if self._arrived_s is None:
            return f"no {self.name} yet"
        age = self.age_s(now_s)
        if age <= self._limit_s:
            return None
        if self._late_s > self._limit_s:
            return f"{self.name} come {self._late_s:.1f} s late"
        return f"no {self.name} for {age:.1f} s"

    def _jumped(self, by_s: float) -> None:
        self._jump = f"the clock of the {self.name} jumped by {by_s:+.1f} s"
