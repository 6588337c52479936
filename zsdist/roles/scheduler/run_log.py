"""What the scheduler asks of the run directory."""

from typing import Protocol

from zsdist.telemetry.snapshot import Fields
from zsdist.wire.messages import State


class RunLog(Protocol):
    """The run directory as the scheduler needs it."""

    def episode(self, record: dict) -> None:
        """Appends one finished episode."""

    def metrics(self, row: Fields) -> None:
        """Appends one line of figures."""

    def checkpoint(self, episodes: int, states: dict[str, State]) -> None:
        """Writes a complete checkpoint, at once or not at all."""

    def summary(self, fields: dict) -> None:
        """Writes the end of the run."""

    def wall_s(self) -> float:
        """How long the run has taken in real time, earlier sittings included."""
