"""Actors of a run as its runner names them."""

import pytest

from zsdist.roles.scheduler.members import Members
from zsdist.roles.schemas import Supervision

OWN, GUEST = "actor-0", "actor-7"


class Bench:
    """Members of a run with one actor of its own, and their epochs."""

    def __init__(self):
        self.members, self.epochs = Members(1), {}

    def follow(self, epochs, left=None, admits=True):
        orders = Supervision(epochs=epochs, left=left or {}, restarts={}, interrupted=False)
        changes = []
        for event, actor, epoch in self.members.changes(orders, self.epochs, admits=admits):
            changes.append((event, actor, epoch))
            if event == "actor_left":
                self.epochs.pop(actor, None)
            else:
                self.epochs[actor] = epoch
        return changes


@pytest.fixture
def bench():
    return Bench()


def test_changes_are_told_once_each(bench):
    assert bench.follow({OWN: 1}) == [("", OWN, 1)]
    assert bench.follow({OWN: 1, GUEST: 2}) == [("actor_joined", GUEST, 2)]
    assert bench.follow({OWN: 3, GUEST: 4}) == [("actor_replaced", OWN, 3), ("actor_replaced", GUEST, 4)]
    assert bench.follow({OWN: 3}, {GUEST: 4}) == [("actor_left", GUEST, 4)]
    assert bench.follow({OWN: 3}, {GUEST: 4}) == []
    assert bench.follow({OWN: 3, GUEST: 5}) == [("actor_joined", GUEST, 5)]
    assert bench.epochs == {OWN: 3, GUEST: 5} and bench.members.left == {}


def test_an_actor_that_is_not_named_stays(bench):
    bench.follow({OWN: 1, GUEST: 2})
    assert bench.follow({}) == [] and bench.epochs == {OWN: 1, GUEST: 2}


def test_an_older_epoch_changes_nothing(bench):
    bench.follow({OWN: 5, GUEST: 6})
    assert bench.follow({OWN: 4, GUEST: 5}, {GUEST: 3}) == []
    assert bench.epochs == {OWN: 5, GUEST: 6}


def test_a_run_that_ends_takes_back_its_own_actors_only(bench):
    bench.follow({OWN: 1})
    assert bench.follow({OWN: 2, GUEST: 3}, admits=False) == [("actor_replaced", OWN, 2)]
    assert bench.epochs == {OWN: 2}


def test_an_actor_of_the_run_leaves_with_its_machine_and_is_replaced_later(bench):
    bench.follow({OWN: 1})
    assert bench.follow({}, {OWN: 1}) == [("actor_left", OWN, 1)] and bench.epochs == {}
    assert bench.follow({}, {OWN: 1}) == [] and bench.members.left == {OWN: 1}
    assert bench.follow({OWN: 2}) == [("actor_replaced", OWN, 2)] and bench.members.left == {}


def test_a_successor_hears_of_those_that_left_before_it_began(bench):
    assert bench.follow({OWN: 1}, {GUEST: 2}) == [("", OWN, 1), ("actor_left", GUEST, 2)]
