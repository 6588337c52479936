import itertools

import pytest

from zsdist.roles.scheduler.pairs import CHANCE, Pairs, chance
from zsdist.types import Outcome


@pytest.mark.parametrize("decided", range(9))
def test_chance_is_the_share_of_equally_likely_outcomes_with_as_many_wins(decided):
    tosses = [sum(toss) for toss in itertools.product((0, 1), repeat=decided)]
    for wins in range(decided + 1):
        share = sum(won >= wins for won in tosses) / len(tosses)
        assert chance(wins, decided - wins) == pytest.approx(share, abs=1e-15)


def test_equals_win_by_more_than_chance_in_one_comparison_of_twenty_at_most():
    for decided in range(200):
        least = min((wins for wins in range(decided + 1) if chance(wins, decided - wins) <= CHANCE), default=None)
        assert least is None or chance(least, decided - least) <= CHANCE < chance(least - 1, decided - least + 1)
    assert chance(5000, 5000) == pytest.approx(0.5, abs=0.01)  # as many scenes as a merge may have


def test_only_scenes_that_both_have_driven_and_that_ended_differently_decide():
    success, timeout, collision = Outcome.SUCCESS, Outcome.TIMEOUT, Outcome.COLLISION
    first = {0: success, 1: success, 2: timeout, 3: collision, 4: success, 5: success}
    second = {0: success, 1: timeout, 2: collision, 3: timeout, 4: collision, 6: collision}
    assert Pairs.of(first, second) == (3, 1)
    assert not Pairs.of(first, second).are_more_than_chance()
    assert Pairs.of(first, second).are_more_than_chance(further_wins=4)  # 7 to 1
    assert not Pairs(4, 0).are_more_than_chance() and Pairs(5, 0).are_more_than_chance()
