import itertools

import pytest

from zsdist.errors import RunError
from zsdist.run.program import RoleSpec
from zsdist.run.restarts import (
    BACKOFF_MAX_S,
    EARLY_DEATHS,
    EARLY_S,
    RESTARTS_ALLOWED,
    WINDOW_S,
    Restarts,
    StandbyPace,
)

FIRST = [
    RoleSpec("hub", "0", 1),
    RoleSpec("scheduler", "0", 2),
    RoleSpec("replay", "0", 3),
    RoleSpec("learner", "low", 4),
    RoleSpec("actor", "1", 5),
]


@pytest.fixture
def restarts():
    epochs = itertools.count(100)
    return Restarts(FIRST, lambda: next(epochs))


def live(restarts, name, start, life_s, words="it died"):
    """Let a role work for a while and die; return its successor."""
    restarts.note_start(name, start)
    restarts.note_sign(name)
    return restarts.replace(name, words, start + life_s)


def test_every_kind_of_role_whose_successor_finds_all_that_counts_is_replaced(restarts):
    replaced = {name for name in restarts.role_specs if restarts.may_replace(name)}
    assert replaced >= {"hub-0", "replay-0", "actor-1", "learner-low"}


def test_each_incarnation_has_the_name_of_its_predecessor_and_an_epoch_of_its_own(restarts):
    second, third = (live(restarts, "actor-1", at, 10.0) for at in (0.0, 20.0))
    assert second.name == third.name == "actor-1"
    assert (second.epoch, third.epoch) == (100, 101)
    assert restarts.role_specs["actor-1"] == third
    assert restarts.role_specs["hub-0"] == FIRST[0]


def test_restarts_are_counted_by_kind_of_role(restarts):
    assert restarts.by_kind() == {}
    for at, name in enumerate(("actor-1", "hub-0", "actor-1")):
        live(restarts, name, 100.0 * at, 10.0)
    assert restarts.by_kind() == {"actor": 2, "hub": 1}


def test_a_role_that_dies_again_and_again_ends_the_run_with_its_last_words_first(restarts):
    for number in range(RESTARTS_ALLOWED):
        live(restarts, "replay-0", 5.0 * number, EARLY_S)
    live(restarts, "actor-1", 0.0, 100.0)  # the count is that of one role
    with pytest.raises(RunError, match=f"^out of memory; it had been restarted {RESTARTS_ALLOWED} times within"):
        live(restarts, "replay-0", 5.0 * RESTARTS_ALLOWED, EARLY_S, "out of memory")


def test_a_run_of_weeks_may_have_any_number_of_restarts(restarts):
    every_s = WINDOW_S / (RESTARTS_ALLOWED - 1)
    for number in range(50 * RESTARTS_ALLOWED):
        live(restarts, "learner-low", every_s * number, every_s)
    assert restarts.by_kind() == {"learner": 50 * RESTARTS_ALLOWED}


@pytest.mark.parametrize("publishes", [True, False])
def test_a_role_that_dies_at_once_each_time_is_given_up_early(restarts, publishes):
    def die(start, life_s):
        restarts.note_start("learner-low", start)
        if publishes:
            restarts.note_sign("learner-low")
        restarts.replace("learner-low", "Killed", start + life_s)

    life_s = EARLY_S / 2 if publishes else 20.0  # long, but it never came to publish anything
    for number in range(EARLY_DEATHS - 1):
        die(100.0 * number, life_s)
    with pytest.raises(RunError, match=f"^Killed; it had been restarted 2 times, and died {EARLY_DEATHS} times at"):
        die(1000.0, life_s)


def test_early_deaths_with_work_between_them_are_not_in_a_row(restarts):
    for number in range(4 * EARLY_DEATHS):
        early = number % EARLY_DEATHS
        live(restarts, "learner-low", 100.0 * number, EARLY_S / 2 if early else 60.0)


def test_a_standby_that_dies_again_and_again_is_started_ever_more_rarely():
    pace, now, starts = StandbyPace(), 0.0, 0
    while now < 3600.0:
        now, starts = max(now, pace.due_s), starts + 1
        pace.note_death(now)
    assert starts < 10 + 3600.0 / BACKOFF_MAX_S
    pace.note_use()
    now = pace.due_s
    pace.note_death(now)
    assert pace.due_s - now < BACKOFF_MAX_S / 10
