"""Actors that join a run from elsewhere, leave it, vanish and come back: the run never waits, and its books balance."""

import numpy as np
import pytest
from guest_run import GuestRun

from zsdist import __version__
from zsdist.roles.scheduler.progress import Stage
from zsdist.run.guests import LOST_AFTER_S
from zsdist.types import Level

MERGES = {"merge": {"every_episodes": 10, "validation_scenes": 6, "distil_updates": 1, "drop_after_scenes": 6}}


@pytest.fixture
def run(tmp_path):
    return lambda **settings: GuestRun(tmp_path / "journal", **settings)


def test_a_guest_drives_its_share_and_ends_with_the_run(run):
    run = run()
    run.until(lambda: len(run.log.episodes) >= 3)
    guest = run.join(3)
    run.finish()
    assert run.drivers() == {"actor-0", "actor-3"}
    run.until(lambda: guest.finished)
    assert run.events["actor_joined"] == 1 and run.scheduler.progress.totals.restarts() == {"actor": 0}


def test_a_guest_that_leaves_delivers_everything_and_its_episodes_are_driven_elsewhere(run):
    run = run()
    guest = run.join(3)
    run.until(lambda: run.scheduler.progress.leases.held_by("actor-3") and guest.env_steps > 5)
    run.leave(guest)
    run.wait(1.0)
    assert run.scheduler.progress.leases.held_by("actor-3") == []
    assert run.finish()["transitions"][Level.LOW]["abandoned_at_most"] == 0
    assert run.events["actor_left"] == 1


def test_a_guest_that_vanishes_is_given_up_after_some_seconds(run):
    run = run()
    guest = run.join(3)
    run.until(lambda: guest.env_steps > 5)
    run.remove(guest)
    run.wait(LOST_AFTER_S - 1.0)
    assert run.scheduler.progress.leases.held_by("actor-3")  # it may come back until then
    run.wait(2.0)
    assert run.scheduler.progress.leases.held_by("actor-3") == []
    run.finish()


def test_a_guest_whose_token_is_away_for_a_moment_stays(run):
    run = run(run={"episodes": 500})
    guest = run.join(3)
    run.wait(1.0)
    guest.transport.close()  # its token is gone, as when its connection breaks
    guest.transport.__init__(run.broker, "actor-3")
    guest.transport.declare_alive("zsdist/flow/alive/actor/3")
    run.wait(2 * LOST_AFTER_S)
    assert "actor-3" in run.guests.epochs and run.events["actor_left"] == 0


def test_while_the_hub_is_away_no_guest_is_given_up(run):
    run = run(run={"episodes": 500})
    run.join(3)
    run.wait(1.0)
    for key in ("actor/3", "scheduler/0"):
        run.broker.announce(f"zsdist/flow/alive/{key}", b"0")
    run.wait(3 * LOST_AFTER_S)
    run.broker.announce("zsdist/flow/alive/scheduler/0", b"1")
    run.wait(LOST_AFTER_S - 1.0)
    assert "actor-3" in run.guests.epochs
    run.wait(2.0)
    assert "actor-3" not in run.guests.epochs


def test_a_guest_comes_back_under_a_new_epoch(run):
    run = run(run={"episodes": 60})
    first = run.join(3)
    run.until(lambda: first.env_steps > 5)
    run.leave(first)
    second = run.join(3, joiner="two", process="second")
    assert second.context.epoch > first.context.epoch
    run.until(lambda: second.env_steps > 5)
    run.remove(second)
    third = run.join(3, joiner="two", process="third")  # at once: its own command knows that the second is dead
    assert third.context.epoch > second.context.epoch
    before = len([None for _, actor in run.log.episodes if actor == "actor-3"])
    run.until(lambda: len([None for _, actor in run.log.episodes if actor == "actor-3"]) > before)
    run.finish()


def test_a_guest_that_was_given_up_and_wakes_does_no_harm_and_knows_it(run):
    run = run(run={"episodes": 200})
    guest = run.join(3)
    run.until(lambda: guest.env_steps > 5)
    run.broker.announce("zsdist/flow/alive/actor/3", b"0")  # it is cut off; what it sends later arrives again
    run.wait(LOST_AFTER_S + 1.0)
    assert not guest.is_named
    held = run.scheduler.progress.leases.held_by("actor-3")
    run.wait(2.0)
    assert held == run.scheduler.progress.leases.held_by("actor-3") == []
    run.finish()


@pytest.mark.parametrize("politely", [True, False])
def test_a_merge_goes_on_when_a_guest_goes(run, politely):
    run = run(**MERGES)
    guests = [run.join(number) for number in (3, 4)]
    run.until(lambda: run.merging and guests[0].actions > 30)
    before = run.now
    run.leave(guests[0]) if politely else run.remove(guests[0])
    run.until(lambda: run.merges == 1)
    assert run.now - before < (LOST_AFTER_S + 10.0)
    run.finish()


def test_a_guest_that_joins_in_a_merge_drives_candidates_too(run):
    merge = MERGES["merge"] | {"validation_scenes": 30, "drop_after_scenes": 30}
    run = run(run={"episodes": 10}, merge=merge)
    run.until(lambda: run.merging and run.scheduler.statistics().get("drives_left", 0) > 40)
    guest = run.join(3)
    run.until(lambda: run.merges == 1)
    assert guest.statistics()["evaluation_produced"] > 0
    run.finish()


def test_a_run_that_ends_takes_no_guest_and_waits_for_none(run):
    run = run()
    leaving, vanishing = run.join(3), run.join(4)
    run.until(lambda: vanishing.env_steps > 5)
    run.interrupted = True
    run.remove(vanishing)
    run.until(lambda: run.stage is Stage.CLOSING)
    late = run.join(5)
    before = run.now
    run.finish()
    assert run.now - before < LOST_AFTER_S + 5.0
    assert leaving.finished and not late.is_named and "actor-5" not in run.scheduler.statistics()


def test_guests_come_and_go_all_the_time_and_the_books_balance(run):
    rng, run, words = np.random.default_rng(0), run(run={"episodes": 80}, **MERGES), 0
    while run.stage is not Stage.DONE:
        number = int(rng.integers(1, 6))
        name, words = f"actor-{number}", words + 1
        present = run.actors.get(name)
        if present is None and run.stage is Stage.TRAIN:
            if run.ask("epoch", name, process=f"p{words}").epoch is not None:
                run.join(number, process=f"p{words}").word = f"p{words}"
        elif present is not None and not present.finished:
            if rng.random() < 0.5:
                run.remove(present)
            elif run.stage is Stage.TRAIN:
                run.leave(present, process=present.word)
            run.actors.pop(name)
        end_s = run.now + float(rng.uniform(0.1, 3.0))
        run.until(lambda: run.now >= end_s or run.stage is Stage.DONE)  # noqa: B023 (called at once)
    run.finish()
    assert run.drivers() > {"actor-0"} and run.events["actor_left"] > 3


# -- questions and answers ----------------------------------------------------------------------------------------


def test_the_terms_say_all_that_an_actor_needs(run):
    run = run()
    run.join(3)
    terms = run.ask("terms", "actor-9")
    assert (terms.run, terms.start, terms.version) == ("flow", "start", __version__)
    assert terms.taken == ["actor-0", "actor-3"]
    assert terms.settings["run"]["cars_per_actor"] == 2 and "tls" not in terms.settings["transport"]
    assert terms.vision == run.spec.vision.to_json()


def test_the_same_question_gets_the_same_epoch_and_another_process_a_new_one(run):
    run = run()
    first = run.ask("epoch", "actor-3").epoch
    assert run.ask("epoch", "actor-3").epoch == first
    assert run.ask("epoch", "actor-3", process="second").epoch > first


def test_the_names_of_others_are_not_given_away(run):
    run = run()
    run.ask("epoch", "actor-3")
    for actor in ("actor-0", "actor-3"):
        verdict = run.ask("epoch", actor, joiner="other", process="other")
        assert verdict.epoch is None and verdict.reason == f"{actor} takes part already"
    run.ask("leave", "actor-3", joiner="other", process="other")
    assert "actor-3" in run.guests.epochs
    run.ask("leave", "actor-3")
    assert run.ask("epoch", "actor-3", joiner="other", process="other").epoch is not None


@pytest.mark.parametrize("actor", ["actor-4096", "actor-01", "actor-x", "learner-low"])
def test_a_name_without_rights_gets_no_answer(run, actor):
    with pytest.raises(ValueError, match="unpack"):
        run().ask("epoch", actor)
