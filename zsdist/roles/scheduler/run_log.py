"""Interface of the run directory, as the scheduler needs it."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from zsdist.telemetry.snapshot import Fields


class RunLog(Protocol):
    """Files that the scheduler writes."""

    def episode(self, record: dict[str, Any]) -> None:
        """Append one finished episode, unless it is there already by its `finished_as`."""

    def metrics(self, row: Fields) -> None:
        """Append one line of figures."""

    def begin_checkpoint(self, episodes: int, states: Mapping[str, bytes], score: float | None) -> Callable[[], None]:
        """Return a function that writes a checkpoint, complete or not at all; it may run beside the other methods.

        Args:
            episodes: count of finished episodes.
            states: states of all roles by name, as encoded messages.
            score: score of the network that won the newest merge; None: there has been none.
        """

    def summary(self, fields: Mapping[str, Any]) -> None:
        """Write the summary of the finished run."""

    def wall_s(self) -> float:
        """Return the real seconds since the files were opened."""
