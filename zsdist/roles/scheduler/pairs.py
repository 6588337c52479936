"""Comparison of two candidates that drove the same scenes: how often chance alone would favour one of them so much."""

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple, Self

from zsdist.types import Outcome

CHANCE = 0.05  # a difference is more than chance if equals would show it more rarely
_RANK = {Outcome.COLLISION: 0, Outcome.TIMEOUT: 1, Outcome.SUCCESS: 2}


def chance(wins: int, losses: int) -> float:
    """Return the probability that of two equals one wins at least so many of these decided scenes.

    It is the one-sided sign test. A scene that ended the same way for both decides nothing and is not counted.
    """
    decided = wins + losses
    ways = term = math.comb(decided, wins)
    for won in range(wins, decided):
        term = term * (decided - won) // (won + 1)
        ways += term
    return ways / (1 << decided)


class Pairs(NamedTuple):
    """Decided scenes of two candidates.

    Attributes:
        wins: number of scenes that ended better for the first one: a success before a timeout before a collision.
        losses: number of those that ended better for the second one.
    """

    wins: int
    losses: int

    @classmethod
    def of(cls, first: Mapping[int, Outcome], second: Mapping[int, Outcome]) -> Self:
        """Compare outcomes by scene; scenes that only one has driven do not count."""
        both: Iterable[int] = first.keys() & second.keys()
        signs = [_RANK[first[scene]] - _RANK[second[scene]] for scene in both]
        return cls(sum(sign > 0 for sign in signs), sum(sign < 0 for sign in signs))

    def are_more_than_chance(self, further_wins: int = 0) -> bool:
        """Return whether the first candidate is better by more than chance, if it wins `further_wins` scenes more."""
        return chance(self.wins + further_wins, self.losses) <= CHANCE
