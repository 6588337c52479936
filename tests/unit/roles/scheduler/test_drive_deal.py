"""Validation drives while actors come and go: none is lost or driven twice, and begun ones stay where they are."""

from itertools import chain

import numpy as np
import pytest

from zsdist.roles.scheduler.drive_deal import DriveDeal
from zsdist.roles.scheduler.merge import deal_drives

CANDIDATES = ("recent", "distilled", "best")
CARS = 2


def drives(scenes):
    return [(name, scene) for scene in range(scenes) for name in CANDIDATES]


def begun(dealt, actors):
    return {actor: dealt[actor][:CARS] for actor in actors}


def test_while_the_actors_stay_drives_are_dealt_in_turn_and_stay():
    deal, outstanding, actors = DriveDeal(CARS), drives(5), ("a", "b")
    while outstanding:
        assert deal.deal(1, outstanding, CANDIDATES, actors) == deal_drives(outstanding, CANDIDATES, actors)
        outstanding.pop(0)


def test_a_new_actor_gets_a_share_and_nobody_loses_what_was_begun():
    deal, outstanding = DriveDeal(CARS), drives(6)
    before = begun(deal.deal(1, outstanding, CANDIDATES, ("a", "b")), ("a", "b"))
    after = deal.deal(1, outstanding, CANDIDATES, ("a", "b", "c"))
    assert begun(after, ("a", "b")) == before
    assert max(map(len, after.values())) - min(map(len, after.values())) <= 1


def test_where_an_actor_leaves_only_its_drives_move():
    deal, outstanding = DriveDeal(CARS), drives(6)
    before = deal.deal(1, outstanding, CANDIDATES, ("a", "b", "c"))
    before = {actor: list(mine) for actor, mine in before.items()}
    after = deal.deal(1, outstanding, CANDIDATES, ("a", "c"))
    for actor in ("a", "c"):
        assert after[actor][: len(before[actor])] == before[actor]


def test_without_actors_drives_wait_for_one():
    deal, outstanding = DriveDeal(CARS), drives(2)
    assert deal.deal(1, outstanding, CANDIDATES, ()) == {}
    assert sorted(deal.deal(1, outstanding, CANDIDATES, ("a",))["a"]) == sorted(outstanding)


def test_a_new_merge_is_dealt_from_the_beginning():
    deal = DriveDeal(CARS)
    deal.deal(1, drives(3)[4:], CANDIDATES, ("a", "b"))
    assert deal.deal(2, drives(3), CANDIDATES, ("a", "b")) == deal_drives(drives(3), CANDIDATES, ("a", "b"))


@pytest.mark.parametrize("seed", range(20))
def test_whoever_comes_and_goes_every_drive_has_one_driver(seed):
    rng, deal, outstanding = np.random.default_rng(seed), DriveDeal(CARS), drives(8)
    while outstanding:
        actors = [name for name in "abcdef" if rng.random() < 0.6]
        dealt = deal.deal(1, outstanding, CANDIDATES, actors)
        assert set(dealt) == set(actors)
        if actors:
            assert sorted(chain(*dealt.values())) == sorted(outstanding)
        for _ in range(int(rng.integers(0, 3))):
            if outstanding:
                outstanding.pop(int(rng.integers(len(outstanding))))
