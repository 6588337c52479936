"""Interface of the run directory, as the scheduler needs it."""

from collections.abc import Mapping
from typing import Any, Protocol

from zsdist.telemetry.snapshot import Fields
from zsdist.wire.messages import State


class RunLog(Protocol):
    """Files that the scheduler writes."""

    def episode(self, record: dict[str, Any]) -> None:
        """Append one finished episode, unless it is there already by its `finished_as`."""

    def metrics(self, row: Fields) -> None:
        """Append one line of figures."""

    def checkpoint(self, episodes: int, states: dict[str, State]) -> None:
        """Write a checkpoint, complete or not at all."""

    def summary(self, fields: Mapping[str, Any]) -> None:
        """Write the summary of the finished run."""

    def wall_s(self) -> float:
        """Return the real seconds since the files were opened."""
