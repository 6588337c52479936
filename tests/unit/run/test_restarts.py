import itertools

import pytest

from zsdist.errors import RunError
from zsdist.run.program import RoleSpec
from zsdist.run.restarts import RESTARTS_ALLOWED, Restarts

FIRST = [
    RoleSpec("hub", "0", 1),
    RoleSpec("scheduler", "0", 2),
    RoleSpec("replay", "0", 3),
    RoleSpec("actor", "1", 4),
    RoleSpec("learner", "high", 5),
]


@pytest.fixture
def restarts():
    epochs = itertools.count(100)
    return Restarts(FIRST, lambda: next(epochs))


def test_only_roles_whose_death_loses_nothing_are_replaced(restarts):
    replaced = {name for name in restarts.role_specs if restarts.may_replace(name)}
    assert replaced == {"hub-0", "scheduler-0", "replay-0", "actor-1"}


def test_each_incarnation_has_the_name_of_its_predecessor_and_an_epoch_of_its_own(restarts):
    second, third = (restarts.replace("actor-1", "it died") for _ in range(2))
    assert second.name == third.name == "actor-1"
    assert (second.epoch, third.epoch) == (100, 101)
    assert restarts.role_specs["actor-1"] == third
    assert restarts.role_specs["hub-0"] == FIRST[0]


def test_restarts_are_counted_by_kind_of_role(restarts):
    assert restarts.by_kind() == {}
    for name in ("actor-1", "hub-0", "actor-1"):
        restarts.replace(name, "it died")
    assert restarts.by_kind() == {"actor": 2, "hub": 1}


def test_a_role_that_dies_again_and_again_ends_the_run(restarts):
    for _ in range(RESTARTS_ALLOWED):
        restarts.replace("replay-0", "it died")
    restarts.replace("actor-1", "it died")  # the count is that of one role
    with pytest.raises(RunError, match=f"out of memory; it had been restarted {RESTARTS_ALLOWED} times"):
        restarts.replace("replay-0", "out of memory")
