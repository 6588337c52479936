"""The merge of the global policy into the target network, as a state machine without messages or clocks.

Every `every_episodes` finished episodes each learner offers candidates; the actors drive every candidate pair greedily
over the same validation scenes; the best becomes the target network. Never a promotion without a comparison.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from zsdist.types import Outcome

RECENT = "recent"  # the online networks as they are
DISTILLED = "distilled"  # recent, drawn towards the guide actions by a large-margin loss
BEST = "best"  # the winner of the last merge: the paper's "historical strategies"


class Phase(StrEnum):
    """Where a merge stands."""

    COLLECT = "collect"  # waiting for the learners' candidates
    DRIVE = "drive"  # actors drive them
    PROMOTE = "promote"  # waiting for the learners to have taken the winner over
    DONE = "done"


@dataclass
class Merge:
    """One merge.

    Attributes:
        index: counts merges of the run from 1.
        episode: finished episodes at which it is due.
        candidates: names driven, each a pair (high, low).
        scenes: how many validation scenes each candidate is to drive.
        drop_after: scenes after which a candidate clearly behind is dropped.
    """

    index: int
    episode: int
    candidates: tuple[str, ...]
    scenes: int
    drop_after: int
    phase: Phase = Phase.COLLECT
    results: dict[str, dict[int, Outcome]] = field(default_factory=dict)
    dropped: set[str] = field(default_factory=set)
    chosen: str = ""

    def __post_init__(self) -> None:
        self.results = {name: {} for name in self.candidates}

    def offered(self, names_by_level: Sequence[set[str]]) -> None:
        """Starts the drives once every level has offered every candidate."""
        if self.phase is Phase.COLLECT and all(set(self.candidates) <= names for names in names_by_level):
            self.phase = Phase.DRIVE

    def outstanding(self) -> list[tuple[str, int]]:
        """Drives still wanted, as (candidate, scene index): all candidates on one scene before the next scene."""
        if self.phase is not Phase.DRIVE:
            return []
        return [
            (name, scene)
            for scene in range(self.scenes)
            for name in self.candidates
            if name not in self.dropped and scene not in self.results[name]
        ]

    def drove(self, name: str, scene: int, outcome: Outcome) -> None:
        """Takes one result; a repeated or unwanted one changes nothing."""
        if self.phase is not Phase.DRIVE or name not in self.results or scene in self.results[name]:
            return
        self.results[name][scene] = outcome
        self._drop_losers()
        if not self.outstanding():
            self.chosen = max(
                self._alive(), key=lambda candidate: (self.score(candidate), -self.candidates.index(candidate))
            )
            self.phase = Phase.PROMOTE

    def promoted(self) -> None:
        """Both learners have taken the winner over."""
        if self.phase is Phase.PROMOTE:
            self.phase = Phase.DONE

    def score(self, name: str) -> float:
        """Success rate minus collision rate over what has been driven."""
        outcomes = list(self.results[name].values())
        wins = outcomes.count(Outcome.SUCCESS) - outcomes.count(Outcome.COLLISION)
        return wins / len(outcomes) if outcomes else 0.0

    def summary(self) -> dict:
        """What `summary.json` keeps of it."""
        return {
            "episode": self.episode,
            "candidates": list(self.candidates),
            "chosen": self.chosen,
            "scores": {name: round(self.score(name), 4) for name in self.candidates},
            "scenes_driven": {name: len(self.results[name]) for name in self.candidates},
        }

    def _alive(self) -> list[str]:
        return [name for name in self.candidates if name not in self.dropped]

    def _drop_losers(self) -> None:
        """Drops a candidate whose score so far is behind the leader's by more than the share of scenes it has left."""
        alive = self._alive()
        if min(len(self.results[name]) for name in alive) < self.drop_after:
            return
        leader = max(alive, key=self.score)
        for name in alive:
            left = self.scenes - len(self.results[name])
            if self.score(leader) - self.score(name) > left / self.scenes:
                self.dropped.add(name)
