"""What the protocol needs to know of a frame; the messages that travel are such frames."""

from typing import Protocol


class Frame(Protocol):
    """A numbered piece of one (stream, actor, epoch); see the attributes of the messages of pushes and records."""

    @property
    def stream(self) -> str:
        """Which stream of its actor."""

    @property
    def actor(self) -> str:
        """Whose it is."""

    @property
    def epoch(self) -> int:
        """Incarnation of the actor."""

    @property
    def sequence(self) -> int:
        """Number of the frame in its epoch, from 0."""

    @property
    def produced(self) -> int:
        """Running total of the epoch, this frame included."""

    @property
    def closes(self) -> bool:
        """Whether it is the last of its epoch."""

    @property
    def count(self) -> int:
        """Transitions or records in it."""
