"""Limit on the ratio of learner updates to inserted transitions, in both directions.

With `r` updates per insert, two bounds hold once `min_size` transitions are stored:

1. updates <= r * stored: the learner never runs ahead of the data.
2. stored + granted but not yet inserted <= (updates + 1) / r + band + grain * streams: the actors run no further ahead
   of the learner.

Each open stream is granted at least one `grain` beyond what it inserted. All streams share the `band` on top of that.
Where a run resumes with another `r`, both counts are taken from there on; what either side owed by the old `r` remains.

So whenever the learner must wait, every open stream has an unused grain, even if all the others use none of theirs, and
one side can always proceed. Before `min_size` is reached nothing is limited; credit in use at that moment is added to
the second bound.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from zsdist.errors import ConfigError, ProtocolError

BAND = 256  # the largest batch (Table 2)


@dataclass
class _Stream:
    """Counts of transitions of one stream."""

    inserted: int = 0
    granted: int = 0  # total since the opening

    @property
    def ahead(self) -> int:
        """Number of transitions granted and not yet inserted."""
        return max(self.granted - self.inserted, 0)


class Limiter:
    """Count the inserts and updates of one level. Grant credit to streams and batches to the learner.

    Sums over the streams are kept up to date, so that a grant takes time for the streams that get credit alone.

    A stream is one actor's epoch. Its credit is the total number of transitions it may produce since it was opened. The
    credit never falls while the stream is open. When it closes, its unused credit returns to the others.

    Args:
        updates_per_insert: learner updates per stored transition, `r`.
        min_size: transitions to store before anything is limited or learned.
        grain: transitions that a stream must be able to produce at once, or none of its trajectories may ever end.
        band: transitions granted beyond one grain a stream, shared by all streams. It hides the latency of credit, and
            should be at least the largest batch (Table 2: 256).

    Attributes:
        patience: number of updates that half of the band allows; the learner may wait for that many batches.
        stored: number of transitions stored so far.
        updates: number of batches handed out so far.

    Raises:
        ConfigError: a count is out of range.
    """

    def __init__(self, updates_per_insert: float, min_size: int, grain: int, band: int = BAND) -> None:
        # Integer arithmetic from here on: a rounding error at a bound could leave both sides waiting.
        self._ratio = Fraction(updates_per_insert).limit_denominator(1_000_000)
        if self._ratio <= 0:
            raise ConfigError(f"updates_per_insert is {updates_per_insert}; allowed is 0.000001 or more")
        for name, value, least in (("min_size", min_size, 1), ("grain", grain, 1), ("band", band, 0)):
            if value < least:
                raise ConfigError(f"limiter {name} is {value}; allowed is {least} or more")
        self._min_size, self._grain, self._band = min_size, grain, band
        self.patience = max(1, int(self._ratio * band / 2))
        self.stored = 0
        self.updates = 0
        self._since = (0, 0)  # transitions stored, and updates due, at which the present ratio began
        self._streams: dict[str, _Stream] = {}
        self._stale = self._changed_streams = True  # since the last grant; the latter: a stream was opened or closed
        self._levels = (grain, grain)  # credit ahead towards which every stream is raised, the second by the band
        self._ahead = 0  # of all streams together
        self._above = [0, 0]  # parts of it that are beyond each level
        self._below: dict[int, set[str]] = {}  # streams that are below the second level, by their credit ahead

    @property
    def limited(self) -> bool:
        """True once `min_size` transitions have been stored, so that the ratio is enforced."""
        return self.stored >= self._min_size

    def open(self, stream: str) -> None:
        """Open a stream that has produced nothing. Raises ProtocolError if it is open already."""
        if stream in self._streams:
            raise ProtocolError(f"stream {stream!r} is already open")
        self._streams[stream] = _Stream()
        self._count_anew()

    def close(self, stream: str) -> int:
        """Close a stream; return its unused credit (0 while unlimited)."""
        ahead = self._find(stream).ahead
        del self._streams[stream]
        self._count_anew()
        return ahead

    def count_inserts(self, stream: str, stored: int, rejected: int = 0) -> None:
        """Count transitions of `stream`: all of them use its credit, only the stored ones count for the ratio."""
        found = self._find(stream)
        self._change(stream, found.inserted + stored + rejected, found.granted)
        self.stored += stored
        self._stale = True

    @property
    def allowed(self) -> int:
        """Number of batches that the learner may take now, one for each update."""
        return max(0, self._due() - self.updates) if self.limited else 0

    @property
    def lacking(self) -> int:
        """Number of transitions without which the learner may take no batch; 0 if it may take one now."""
        if self.allowed:
            return 0
        wanted = -(-(self.updates + 1) * self._ratio.denominator // self._ratio.numerator)
        return max(wanted, self._min_size) - self.stored

    def take_batch(self) -> None:
        """Count a batch that is handed out. Raises ProtocolError if none is allowed."""
        if not self.allowed:
            raise ProtocolError(
                f"update {self.updates + 1} with {self.stored} transitions stored; allowed are {self._ratio} of each"
            )
        self.updates += 1
        self._stale = True

    def resume_at(self, updates: int) -> None:
        """Set the number of batches that this limiter's predecessor has handed out."""
        self.updates = updates
        self._stale = True

    def credit(self, stream: str) -> int | None:
        """Return the total number of transitions that `stream` may produce; None: no limit yet."""
        found = self._find(stream)
        if not self.limited:
            return None
        if self._stale:
            self._grant()
            self._stale = False
        return found.granted

    def state(self) -> dict[str, Any]:
        """Return the totals and the counts of each open stream."""
        streams = {name: [stream.inserted, stream.granted] for name, stream in self._streams.items()}
        ratio = [self._ratio.numerator, self._ratio.denominator]
        return {
            "stored": self.stored,
            "updates": self.updates,
            "ratio": ratio,
            "since": list(self._since),
            "streams": streams,
        }

    def restore(self, state: dict[str, Any], *, same_run: bool) -> None:
        """Restore what `state` returned; its streams only in the same run, since epochs end with a run.

        A state of an earlier version names no ratio; then the present one begins here, and nothing is owed.
        """
        self.stored, self.updates = int(state["stored"]), int(state["updates"])
        if "ratio" in state:
            present, self._ratio = self._ratio, Fraction(*state["ratio"])
            self._since = (int(state["since"][0]), int(state["since"][1]))
            if present != self._ratio:
                self._since, self._ratio = (self.stored, self._due()), present
        else:
            self._since = (self.stored, self.updates)
        self._streams = {name: _Stream(*counts) for name, counts in state["streams"].items()} if same_run else {}
        self._count_anew()

    def _grant(self) -> None:
        """Grant credit: first a grain to every stream, then shares of the band."""
        if self._changed_streams:
            self._count()
        stored, due = self._since
        room = stored + int((self.updates + 1 - due) / self._ratio) - self.stored + self._band
        room += self._grain * len(self._streams) - self._ahead
        room -= self._top_up(0, room)
        # Unused credit beyond the grains must not exceed the band, or idle streams could take a late stream's grain.
        self._top_up(1, min(room, self._band - self._above[0]))

    def _count_anew(self) -> None:
        """Note that a stream was opened or closed, after which the levels and all sums change."""
        self._stale = self._changed_streams = True

    def _count(self) -> None:
        """Compute levels and sums from all streams."""
        self._changed_streams = False
        self._levels = (self._grain, self._grain + self._band // max(1, len(self._streams)))
        aheads = {name: stream.ahead for name, stream in self._streams.items()}
        self._ahead = sum(aheads.values())
        self._above = [sum(max(ahead - level, 0) for ahead in aheads.values()) for level in self._levels]
        self._below = {}
        for name, ahead in aheads.items():
            if ahead < self._levels[1]:
                self._below.setdefault(ahead, set()).add(name)

    def _change(self, name: str, inserted: int, granted: int) -> None:
        """Change the counts of a stream, and all sums with them."""
        stream = self._streams[name]
        before = stream.ahead
        stream.inserted, stream.granted = inserted, granted
        after = stream.ahead
        self._ahead += after - before
        for index, level in enumerate(self._levels):
            self._above[index] += max(after - level, 0) - max(before - level, 0)
        if name in self._below.get(before, ()):
            self._below[before].remove(name)
            if not self._below[before]:
                del self._below[before]
        if after < self._levels[1]:
            self._below.setdefault(after, set()).add(name)

    def _due(self) -> int:
        """Return the number of updates that the stored transitions ask for."""
        ratio, (stored, due) = self._ratio, self._since
        # As integers: a product of fractions takes longer than sampling a batch.
        return due + ratio.numerator * (self.stored - stored) // ratio.denominator

    def _top_up(self, index: int, room: int) -> int:
        """Raise every stream towards a level, in proportion if `room` is short; return the credit granted."""
        level = self._levels[index]
        wanted = level * len(self._streams) - self._ahead + self._above[index]
        if room <= 0 or not wanted:
            return 0
        shares = []
        for ahead in sorted(self._below):
            lack = max(level - ahead, 0)
            more = lack if room >= wanted else lack * room // wanted
            if not more:
                break  # nor do those get any that lack less
            shares += [(name, more) for name in self._below[ahead]]
        for name, more in shares:
            stream = self._streams[name]
            self._change(name, stream.inserted, max(stream.granted, stream.inserted) + more)
        return sum(more for _, more in shares)

    def _find(self, stream: str) -> _Stream:
        if stream not in self._streams:
            raise ProtocolError(f"stream {stream!r} is not open; open are {sorted(self._streams)}")
        return self._streams[stream]
