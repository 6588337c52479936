"""Merge of the global policy into the target network, as a state machine without messages or clocks.

Every `every_episodes` finished episodes each learner offers candidates. The actors drive every pair of candidates
greedily over the same validation scenes, and the best pair becomes the target network. Nothing is promoted without a
comparison.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Self, TypedDict

from zsdist.roles.schemas import CandidateName, Phase
from zsdist.types import Outcome

NO_MERGE: dict[str, Any] = {"merge": 0, "phase": "", "candidates": [], "chosen": ""}  # `Merge.orders` without one
Drive = tuple[CandidateName, int]  # a candidate, and the index of the validation scene that it drives


class MergeSummary(TypedDict):
    """Entry of a merge in `summary.json` and in checkpoints."""

    episode: int
    candidates: list[CandidateName]
    chosen: str
    scores: dict[str, float]
    scenes_driven: dict[str, int]


@dataclass
class Merge:
    """One merge.

    Attributes:
        index: number of the merge in its run, from 1.
        episode: count of finished episodes at which it began.
        candidates: names that are driven, each of a pair (high, low).
        scenes: number of validation scenes for each candidate.
        drop_after: number of scenes after which a candidate may be dropped.
        phase: present phase.
        results: outcome by candidate and index of the scene.
        dropped: candidates that are out of the comparison.
        chosen: name of the winner; empty until it is known.
    """

    index: int
    episode: int
    candidates: tuple[CandidateName, ...]
    scenes: int
    drop_after: int
    phase: Phase = Phase.COLLECT
    results: dict[CandidateName, dict[int, Outcome]] = field(default_factory=dict)
    dropped: set[CandidateName] = field(default_factory=set)
    chosen: CandidateName | None = None

    def __post_init__(self) -> None:
        self.results = {name: {} for name in self.candidates}

    def start_drives(self, names_by_level: Sequence[set[str]]) -> None:
        """Start the drives once every level has offered every candidate."""
        if self.phase is Phase.COLLECT and all(set(self.candidates) <= names for names in names_by_level):
            self.phase = Phase.DRIVE

    def outstanding(self) -> list[Drive]:
        """Return the drives that are still wanted: all candidates on one scene before the next scene."""
        if self.phase is not Phase.DRIVE:
            return []
        return [
            (name, scene)
            for scene in range(self.scenes)
            for name in self.candidates
            if name not in self.dropped and scene not in self.results[name]
        ]

    def add_result(self, name: CandidateName, scene: int, outcome: Outcome) -> None:
        """Record one result; a repeated or unwanted one changes nothing."""
        if self.phase is not Phase.DRIVE or name not in self.results or scene in self.results[name]:
            return
        self.results[name][scene] = outcome
        self._drop_losers()
        if not self.outstanding():
            # On a tie the first candidate wins: the recent networks, where they are among the best.
            winner = max(self._alive(), key=self._rank)
            self.chosen, self.phase = winner, Phase.PROMOTE

    def finish(self) -> None:
        """End the merge: both learners have taken over the winner."""
        if self.phase is Phase.PROMOTE:
            self.phase = Phase.DONE

    def score(self, name: CandidateName) -> float:
        """Return the success rate minus the collision rate over the scenes driven so far."""
        outcomes = list(self.results[name].values())
        wins = outcomes.count(Outcome.SUCCESS) - outcomes.count(Outcome.COLLISION)
        return wins / len(outcomes) if outcomes else 0.0

    def orders(self) -> dict[str, Any]:
        """Return the part of the learners' orders that concerns this merge."""
        return {
            "merge": self.index,
            "phase": self.phase.value,
            "candidates": list(self.candidates),
            "chosen": self.chosen or "",
        }

    def outline(self) -> dict[str, Any]:
        """Return the merge without its results as plain data, for `restored`."""
        return {
            "index": self.index,
            "episode": self.episode,
            "candidates": list(self.candidates),
            "scenes": self.scenes,
            "drop_after": self.drop_after,
            "phase": self.phase.value,
        }

    def state(self) -> dict[str, Any]:
        """Return the whole merge as plain data, for `restored`."""
        results = {name: [[scene, outcome.value] for scene, outcome in of.items()] for name, of in self.results.items()}
        return self.outline() | {"results": results, "dropped": sorted(self.dropped), "chosen": self.chosen}

    @classmethod
    def restored(cls, state: dict[str, Any]) -> Self:
        """Return the merge of a `state`, or of an `outline`, to which its results are added then."""
        about = {name: state[name] for name in ("index", "episode", "scenes", "drop_after")}
        merge = cls(**about, candidates=tuple(state["candidates"]), phase=Phase(state["phase"]))
        for name, results in state.get("results", {}).items():
            merge.results[name] = {scene: Outcome(outcome) for scene, outcome in results}
        merge.dropped, merge.chosen = set(state.get("dropped", ())), state.get("chosen")
        return merge

    def summary(self) -> MergeSummary:
        """Return the entry of this merge in `summary.json`."""
        return {
            "episode": self.episode,
            "candidates": list(self.candidates),
            "chosen": self.chosen or "",
            "scores": {name: round(self.score(name), 4) for name in self.candidates},
            "scenes_driven": {name: len(self.results[name]) for name in self.candidates},
        }

    def _rank(self, name: CandidateName) -> tuple[float, int]:
        return self.score(name), -self.candidates.index(name)

    def _alive(self) -> list[CandidateName]:
        return [name for name in self.candidates if name not in self.dropped]

    def _drop_losers(self) -> None:
        """Drop a candidate whose score so far is behind the leader's by more than the share of scenes it has left."""
        alive = self._alive()
        if min(len(self.results[name]) for name in alive) < self.drop_after:
            return
        leader = max(alive, key=self.score)
        for name in alive:
            left = self.scenes - len(self.results[name])
            if self.score(leader) - self.score(name) > left / self.scenes:
                self.dropped.add(name)


def next_merge_at(last: int, every: int, target: int) -> int:
    """Return the count of finished episodes at which the next merge is due.

    Merges are due at the multiples of `every`. If the run ends before the next multiple, a merge is due at its end,
    provided that at least half of `every` has passed since the last merge.

    Args:
        last: count of finished episodes at the last merge; 0 before the first.
        every: `merge.every_episodes`; 0 means that there are no merges.
        target: number of episodes of the whole run.

    Returns:
        The count; above `target` where the run ends before.
    """
    if not every:
        return target + 1
    barrier = (last // every + 1) * every
    return target if last + every / 2 <= target < barrier else barrier


def deal_drives(
    outstanding: Sequence[Drive], candidates: Sequence[CandidateName], actors: Sequence[str]
) -> dict[str, list[Drive]]:
    """Return the drives of each actor.

    Drives are dealt in turn, by scene and candidate alone, so a drive stays with its actor while others finish.

    Args:
        outstanding: drives that are still wanted.
        candidates: all candidates of the merge.
        actors: names of all actors, in a fixed order; at least one where a drive is wanted.
    """
    drives: dict[str, list[Drive]] = {actor: [] for actor in actors}
    for name, scene in outstanding:
        drives[actors[(scene + candidates.index(name)) % len(actors)]].append((name, scene))
    return drives
