"""Watch over a run that stands still: every role is alive, nothing moves, and each waits for another."""

from collections.abc import Callable

from zsdist.telemetry.snapshot import Snapshot
from zsdist.types import Level

STANDSTILL_S = 60.0  # time without any progress after which a run counts as standing still
_PROGRESS = (("actor", "actions"), ("learner", "learner_updates"), ("scheduler", "episodes"))


class StandstillWatch:
    """Watch that reports once each `STANDSTILL_S` while no car acts, no learner updates and no episode ends."""

    def __init__(self) -> None:
        self._progress: list[float] = []
        self._moved_s = self._report_s = 0.0

    def watch(self, now: float, snapshot: Snapshot, publish: Callable[..., None]) -> None:
        """Look at a run, and publish who waits for what if it stands still.

        Args:
            now: current time in seconds.
            snapshot: statistics of all roles.
            publish: function that publishes an event, `Role.event`.
        """
        progress = [snapshot.total(role, name) for role, name in _PROGRESS]
        if not self._progress or progress != self._progress:
            self._progress, self._moved_s, self._report_s = progress, now, now + STANDSTILL_S
        if now < self._report_s:
            return
        self._report_s = now + STANDSTILL_S
        cars, driving = (int(snapshot.total("actor", name)) for name in ("cars_waiting_credit", "cars_driving"))
        in_flight = sum(
            int(snapshot.total("actor", f"{level}_{name}"))
            for level in Level
            for name in ("unacknowledged_frames", "waiting")
        )
        publish(
            now,
            "standstill",
            since_s=round(now - self._moved_s, 1),
            actors=len(snapshot.of("actor")),
            cars_driving=driving,
            cars_waiting_credit=cars,
            in_flight=in_flight,
            waits="; ".join([f"{cars} of {driving} driving cars for credit", *_learner_waits(snapshot)]),
        )


def _learner_waits(snapshot: Snapshot) -> list[str]:
    waits = []
    for level in Level:
        lacking, held = (int(snapshot.total("replay", f"{level}_{name}")) for name in ("transitions_lacking", "size"))
        if level.value not in snapshot.of("learner"):
            waits.append(f"learner {level} to report")
        elif lacking:
            waits.append(f"learner {level} for {lacking} more transitions ({held} are held)")
    return waits
