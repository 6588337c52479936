"""Interface of the frames that the protocol delivers; the messages `Push` and `Records` implement it."""

from typing import Protocol


class Frame(Protocol):
    """Numbered frame of one (stream, actor, epoch)."""

    @property
    def stream(self) -> str:
        """Name of the stream: a level, or a stream of records."""

    @property
    def actor(self) -> str:
        """Name of the actor."""

    @property
    def epoch(self) -> int:
        """Incarnation of the actor."""

    @property
    def sequence(self) -> int:
        """Number of the frame in its epoch, from 0 without gaps."""

    @property
    def produced(self) -> int:
        """Running total of transitions or records of the epoch, this frame included."""

    @property
    def closes(self) -> bool:
        """True for the last frame of the epoch."""

    @property
    def count(self) -> int:
        """Number of transitions or records in the frame."""

    @property
    def nbytes(self) -> int:
        """Bytes that the content takes in memory, roughly."""
