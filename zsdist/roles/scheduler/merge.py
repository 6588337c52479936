"""Merge of the global policy into the target network, as a state machine without messages or clocks.

Every `every_episodes` finished episodes each learner offers candidates. Beside training the actors drive every pair of
candidates greedily over the same validation scenes, and the best pair becomes the target network. Nothing is promoted
without a comparison.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Self, TypedDict

from zsdist.roles.scheduler.pairs import Pairs
from zsdist.roles.schemas import BEST, CandidateName
from zsdist.types import Outcome

NO_MERGE: dict[str, Any] = {"merge": 0, "candidates": [], "driven": 0, "chosen": ""}  # `Merge.orders` without one
Drive = tuple[CandidateName, int]  # a candidate, and the index of the validation scene that it drives


class MergeCost(TypedDict):
    """Cost of a merge: its time by the clock of the run, and the drives that were counted with their actions."""

    seconds: float
    drives: int
    actions: int


class MergeSummary(TypedDict):
    """Entry of a merge in `summary.json` and in checkpoints."""

    episode: int
    candidates: list[CandidateName]
    chosen: str
    scores: dict[str, float]
    scenes_driven: dict[str, int]
    cost: MergeCost


@dataclass
class Merge:
    """One merge.

    Attributes:
        index: number of the merge in its run, from 1.
        episode: count of finished episodes at which it was due.
        candidates: names that are driven, each of a pair (high, low).
        scenes: number of validation scenes for each candidate.
        drop_after: number of scenes after which a candidate may be dropped.
        began_s: time at which it began, seconds; None until that is known.
        results: outcome by candidate and index of the scene.
        actions: number of actions of all drives.
        dropped: candidates that are out of the comparison.
        chosen: name of the winner, which the learners then promote; None until it is known.
    """

    index: int
    episode: int
    candidates: tuple[CandidateName, ...]
    scenes: int
    drop_after: int
    began_s: float | None = None
    results: dict[CandidateName, dict[int, Outcome]] = field(default_factory=dict)
    actions: int = 0
    dropped: set[CandidateName] = field(default_factory=set)
    chosen: CandidateName | None = None

    def __post_init__(self) -> None:
        self.results = {name: {} for name in self.candidates}

    @property
    def drives(self) -> int:
        """Number of drives that were counted."""
        return sum(map(len, self.results.values()))

    def outstanding(self) -> list[Drive]:
        """Return the drives that are still wanted: all candidates on one scene before the next scene."""
        if self.chosen is not None:
            return []
        return [
            (name, scene)
            for scene in range(self.scenes)
            for name in self.candidates
            if name not in self.dropped and scene not in self.results[name]
        ]

    def add_result(self, name: CandidateName, scene: int, outcome: Outcome, actions: int) -> None:
        """Record one result; a repeated or unwanted one changes nothing."""
        if self.chosen is not None or name not in self.results or scene in self.results[name]:
            return
        self.results[name][scene] = outcome
        self.actions += actions
        self._drop_losers()
        if not self.outstanding():
            self.chosen = self._winner()

    def score(self, name: CandidateName) -> float:
        """Return the success rate minus the collision rate over the scenes driven so far."""
        outcomes = list(self.results[name].values())
        wins = outcomes.count(Outcome.SUCCESS) - outcomes.count(Outcome.COLLISION)
        return wins / len(outcomes) if outcomes else 0.0

    def orders(self) -> dict[str, Any]:
        """Return the part of the learners' orders that concerns this merge."""
        return {
            "merge": self.index,
            "candidates": list(self.candidates),
            "driven": self.drives,
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
            "began_s": self.began_s,
        }

    def state(self) -> dict[str, Any]:
        """Return the whole merge as plain data, for `restored`."""
        results = {name: [[scene, outcome.value] for scene, outcome in of.items()] for name, of in self.results.items()}
        about = {"results": results, "actions": self.actions, "dropped": sorted(self.dropped), "chosen": self.chosen}
        return self.outline() | about

    @classmethod
    def restored(cls, state: dict[str, Any]) -> Self:
        """Return the merge of a `state`, or of an `outline`, to which its results are added then."""
        about = {name: state[name] for name in ("index", "episode", "scenes", "drop_after", "began_s")}
        merge = cls(**about, candidates=tuple(state["candidates"]))
        for name, results in state.get("results", {}).items():
            merge.results[name] = {scene: Outcome(outcome) for scene, outcome in results}
        merge.actions, merge.dropped = state.get("actions", 0), set(state.get("dropped", ()))
        merge.chosen = state.get("chosen")
        return merge

    def summary(self, seconds: float) -> MergeSummary:
        """Return the entry of this merge in `summary.json`; it took `seconds`."""
        return {
            "episode": self.episode,
            "candidates": list(self.candidates),
            "chosen": self.chosen or "",
            "scores": {name: round(self.score(name), 4) for name in self.candidates},
            "scenes_driven": {name: len(self.results[name]) for name in self.candidates},
            "cost": {"seconds": round(seconds, 3), "drives": self.drives, "actions": self.actions},
        }

    def _winner(self) -> CandidateName:
        """Return the winner: the best of what was learned, unless the last winner is better by more than chance.

        Of equal ones it is the first: the recent networks, where they are among the best.
        """
        learned = max(self._learned(), key=lambda name: (self.score(name), -self.candidates.index(name)))
        return BEST if self._is_alive(BEST) and self._best_over(learned).are_more_than_chance() else learned

    def _learned(self) -> list[CandidateName]:
        return [name for name in self.candidates if name != BEST and self._is_alive(name)]

    def _is_alive(self, name: CandidateName) -> bool:
        return name in self.candidates and name not in self.dropped

    def _best_over(self, name: CandidateName) -> Pairs:
        return Pairs.of(self.results[BEST], self.results[name])

    def _drop_losers(self) -> None:
        """Drop candidates that have no prospect of winning.

        One of those that were learned is dropped once its score so far is behind the leader's by more than the share of
        scenes it has left. The last winner is dropped once it could win all scenes it has left without being better by
        more than chance.
        """
        learned = self._learned()
        if min(len(self.results[name]) for name in self.candidates if self._is_alive(name)) < self.drop_after:
            return
        leader = max(learned, key=self.score)
        for name in learned:
            left = self.scenes - len(self.results[name])
            if self.score(leader) - self.score(name) > left / self.scenes:
                self.dropped.add(name)
        if self._is_alive(BEST) and not any(self._may_win(name) for name in self._learned()):
            self.dropped.add(BEST)

    def _may_win(self, rival: CandidateName) -> bool:
        """Return whether the last winner may still turn out better than a rival by more than chance."""
        both = self.results[BEST].keys() & self.results[rival].keys()
        return self._best_over(rival).are_more_than_chance(self.scenes - len(both))


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
