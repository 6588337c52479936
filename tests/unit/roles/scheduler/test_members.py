"""Actors of a run as its runner names them."""

from zsdist.roles.scheduler.members import Members
from zsdist.roles.schemas import Supervision

OWN, GUEST = "actor-0", "actor-7"


def follow(members, epochs, left=None, admits=True):
    orders = Supervision(epochs=epochs, left=left or {}, restarts={}, interrupted=False)
    return [tuple(change) for change in members.follow(orders, admits=admits)]


def test_changes_are_told_once_each():
    members = Members(1)
    assert follow(members, {OWN: 1}) == [("", OWN, 1)]
    assert follow(members, {OWN: 1, GUEST: 2}) == [("actor_joined", GUEST, 2)]
    assert follow(members, {OWN: 3, GUEST: 4}) == [("actor_replaced", OWN, 3), ("actor_replaced", GUEST, 4)]
    assert follow(members, {OWN: 3}, {GUEST: 4}) == [("actor_left", GUEST, 4)]
    assert follow(members, {OWN: 3}, {GUEST: 4}) == []
    assert follow(members, {OWN: 3, GUEST: 5}) == [("actor_joined", GUEST, 5)]
    assert members.epochs == {OWN: 3, GUEST: 5} and members.left == {}


def test_an_actor_that_is_not_named_stays():
    members = Members(1)
    follow(members, {OWN: 1, GUEST: 2})
    assert follow(members, {}) == [] and members.epochs == {OWN: 1, GUEST: 2}


def test_an_older_epoch_changes_nothing():
    members = Members(1)
    follow(members, {OWN: 5, GUEST: 6})
    assert follow(members, {OWN: 4, GUEST: 5}, {GUEST: 3}) == []
    assert members.epochs == {OWN: 5, GUEST: 6}


def test_a_run_that_ends_takes_back_its_own_actors_only():
    members = Members(1)
    follow(members, {OWN: 1})
    assert follow(members, {OWN: 2, GUEST: 3}, admits=False) == [("actor_replaced", OWN, 2)]
    assert members.epochs == {OWN: 2}


def test_a_successor_hears_of_those_that_left_before_it_began():
    assert follow(Members(1), {OWN: 1}, {GUEST: 2}) == [("", OWN, 1), ("actor_left", GUEST, 2)]
