"""Holds the ratio of learner updates to inserted transitions from both sides.

With `r` updates per insert, two things hold once `min_size` transitions are stored:

1. updates <= r * stored: the learner never runs ahead of the data;
2. stored + granted and not yet inserted <= (updates + 1) / r + band + grain * streams: the actors never run further
   ahead of the learner than that.

Each live stream is entitled to a `grain` granted ahead of what it inserted; the `band` is shared on top of that. So
when the learner must wait, every live stream has been granted a grain it has not used, even if all the others hoard
theirs: one side can always go on. Before `min_size` nothing is limited; what is out when it is reached comes on top.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from zsdist.errors import ConfigError, ProtocolError

BAND = 256  # the largest batch (Table 2)


@dataclass
class _Stream:
    inserted: int = 0
    granted: int = 0  # absolute

    @property
    def ahead(self) -> int:
        return max(self.granted - self.inserted, 0)


class Limiter:
    """Counts inserts and updates of one level; grants credit to streams and batches to the learner.

    A stream is one actor's epoch. Its credit is the absolute number of transitions it may have produced since it
    opened; it never falls while the stream lives, and what is unused returns to the others when it closes.

    Args:
        updates_per_insert: learner updates per stored transition, `r`.
        min_size: transitions stored in all before anything is limited or learned.
        grain: transitions a stream must be able to produce at once (cars of an actor times the longest option).
        band: transitions granted ahead, shared by all streams, beyond a grain each; it hides the time that credit is
            under way, and should be at least the largest batch (Table 2: 256).

    Attributes:
        unhurried: batches for which the learner can wait before the actors have used up half of the band.

    Raises:
        ConfigError: a count is out of range.
    """

    def __init__(self, updates_per_insert: float, min_size: int, grain: int, band: int = BAND) -> None:
        # Whole numbers from here on: a rounding error at a limit could leave both sides waiting.
        self._ratio = Fraction(updates_per_insert).limit_denominator(1_000_000)
        if self._ratio <= 0:
            raise ConfigError(f"updates_per_insert is {updates_per_insert}; allowed is 0.000001 or more")
        for name, value, least in (("min_size", min_size, 1), ("grain", grain, 1), ("band", band, 0)):
            if value < least:
                raise ConfigError(f"limiter {name} is {value}; allowed is {least} or more")
        self._min_size, self._grain, self._band = min_size, grain, band
        self.unhurried = max(1, int(self._ratio * band / 2))
        self.stored = 0
        self.updates = 0
        self._streams: dict[str, _Stream] = {}
        self._stale = True  # grants have not been looked at since something changed

    @property
    def limited(self) -> bool:
        """Whether `min_size` transitions have been stored, so that both sides are held to the ratio."""
        return self.stored >= self._min_size

    def open(self, stream: str) -> None:
        """A new stream, at 0 produced. Raises ProtocolError if it is open."""
        if stream in self._streams:
            raise ProtocolError(f"stream {stream!r} is already open")
        self._streams[stream] = _Stream()
        self._stale = True

    def close(self, stream: str) -> int:
        """Ends a stream and returns the credit it had been granted and did not insert (0 while unlimited)."""
        self._stale = True
        self._find(stream)
        return self._streams.pop(stream).ahead

    def inserted(self, stream: str, stored: int, rejected: int = 0) -> None:
        """Transitions of `stream` have come: both kinds use its credit, only the stored ones count for the ratio."""
        self._find(stream).inserted += stored + rejected
        self.stored += stored
        self._stale = True

    @property
    def allowed(self) -> int:
        """Batches, of an update each, that the learner may take now."""
        ratio = self._ratio  # by whole numbers: a product of fractions takes longer than drawing a batch's rows
        return max(0, ratio.numerator * self.stored // ratio.denominator - self.updates) if self.limited else 0

    def sampled(self) -> None:
        """A batch was handed out. Raises ProtocolError where none is allowed."""
        if not self.allowed:
            raise ProtocolError(
                f"update {self.updates + 1} of {self.stored} transitions; allowed is {self._ratio} of each"
            )
        self.updates += 1
        self._stale = True

    def catch_up(self, updates: int) -> None:
        """Batches were handed out before this limiter was made, `updates` in all."""
        self.updates = updates
        self._stale = True

    def credit(self, stream: str) -> int | None:
        """Transitions `stream` may have produced in all; None: no limit yet."""
        found = self._find(stream)
        if not self.limited:
            return None
        if self._stale:
            self._grant()
            self._stale = False
        return found.granted

    def state(self) -> dict[str, Any]:
        """The totals, and what each open stream inserted and was granted."""
        streams = {name: [stream.inserted, stream.granted] for name, stream in self._streams.items()}
        return {"stored": self.stored, "updates": self.updates, "streams": streams}

    def restore(self, state: dict[str, Any], *, same_run: bool) -> None:
        """Takes over a `state()`; its streams only if their run still goes on, since epochs end with it."""
        self.stored, self.updates = int(state["stored"]), int(state["updates"])
        self._streams = {name: _Stream(*counts) for name, counts in state["streams"].items()} if same_run else {}
        self._stale = True

    def _grant(self) -> None:
        streams = self._streams.values()
        room = int((self.updates + 1) / self._ratio) + self._band + self._grain * len(streams) - self.stored
        room -= sum(stream.ahead for stream in streams)
        room -= self._top_up(self._grain, room)
        # Beyond the grains no more than the band may ever be out, or hoarders could eat a late stream's grain.
        beyond = sum(max(stream.ahead - self._grain, 0) for stream in streams)
        self._top_up(self._grain + self._band // len(streams), min(room, self._band - beyond))

    def _top_up(self, ahead: int, room: int) -> int:
        """Lifts every stream towards `ahead`, in proportion where `room` is short; returns what was granted."""
        lacking = {name: ahead - s.ahead for name, s in self._streams.items() if s.ahead < ahead}
        wanted = sum(lacking.values())
        if room <= 0 or not wanted:
            return 0
        granted = 0
        for name, lack in lacking.items():
            more = lack if room >= wanted else lack * room // wanted
            stream = self._streams[name]
            stream.granted = max(stream.granted, stream.inserted) + more
            granted += more
        return granted

    def _find(self, stream: str) -> _Stream:
        if stream not in self._streams:
            raise ProtocolError(f"stream {stream!r} is not open; open are {sorted(self._streams)}")
        return self._streams[stream]
