"""Actors whose process dies and whose successor waits for a machine: the run goes on without them meanwhile."""

import numpy as np
import pytest
from flow import NoPictures, NoScenes
from guest_run import GuestRun, SlowCar

from zsdist.roles.actor import Actor
from zsdist.roles.scheduler.progress import Stage
from zsdist.run.presence import ABSENT_S, WAITS_S, Presence
from zsdist.run.program import RoleSpec

HERE, AWAY, REPLAY = (RoleSpec(role, number, 1) for role, number in (("actor", "0"), ("actor", "1"), ("replay", "0")))
MERGES = {"merge": {"every_episodes": 10, "validation_scenes": 6, "distil_updates": 1, "drop_after_scenes": 6}}


def newer(role_spec):
    return RoleSpec(role_spec.role, role_spec.id, role_spec.epoch + 10)


# -- decisions ------------------------------------------------------------------------------------------------------


def test_an_actor_is_named_from_the_answer_of_its_process_on():
    presence = Presence()
    presence.update([REPLAY, HERE, AWAY], {"actor-0", "replay-0"}.__contains__, 0.0)
    assert (presence.actors, presence.left) == ([HERE], {})
    presence.update([REPLAY, HERE, AWAY], lambda name: True, 1.0)
    assert (presence.actors, presence.left) == ([HERE, AWAY], {})


def test_one_whose_successor_waits_has_left_until_that_one_answers():
    presence = Presence()
    presence.update([HERE, AWAY], lambda name: True, 0.0)
    for now in (1.0, 2.0):
        presence.update([HERE, newer(AWAY)], {"actor-0"}.__contains__, now)
        assert (presence.actors, presence.left) == ([HERE], {"actor-1": AWAY.epoch})
    presence.update([HERE, newer(newer(AWAY))], {"actor-0"}.__contains__, 3.0)  # its successor died unseen
    assert presence.left == {"actor-1": AWAY.epoch}
    presence.update([HERE, newer(newer(AWAY))], lambda name: True, 4.0)
    assert (presence.actors, presence.left) == ([HERE, newer(newer(AWAY))], {})


def test_one_that_is_replaced_by_a_waiting_process_never_leaves():
    presence = Presence()
    presence.update([HERE], lambda name: True, 0.0)
    presence.update([newer(HERE)], lambda name: True, 1.0)
    assert (presence.actors, presence.left) == ([newer(HERE)], {})


def test_who_waits_long_is_told_once_for_each_incarnation():
    presence, told = Presence(), []
    for now in range(int(3 * WAITS_S)):
        replay = REPLAY if now < 1.5 * WAITS_S else newer(REPLAY)
        news = presence.update([HERE, replay], {"actor-0"}.__contains__, float(now))
        told += [(now, name) for name in news]
    assert told == [(WAITS_S, "replay-0"), (2.5 * WAITS_S, "replay-0")]


def test_only_roles_that_a_run_cannot_be_saved_without_are_absent_and_only_after_a_while():
    presence = Presence()
    for now in (0.0, ABSENT_S - 0.1, ABSENT_S):
        presence.update([REPLAY, HERE], {}.__contains__, now)
        assert presence.absent(now) == (["replay-0"] if now == ABSENT_S else [])
    presence.update([REPLAY, HERE], {"replay-0"}.__contains__, 2 * ABSENT_S)
    assert presence.absent(2 * ABSENT_S) == []


# -- whole runs -----------------------------------------------------------------------------------------------------


class LostRun(GuestRun):
    """Run with two actors of its own, of which some are there, under a runner that knows of which it has a process."""

    def __init__(self, folder, there=(0, 1), **settings):
        super().__init__(folder, (), **{**settings, "run": {"actors": 2, **settings.get("run", {})}})
        self.presence, self.present = Presence(), {}
        self.role_specs = {f"actor-{number}": RoleSpec("actor", str(number), 1) for number in range(2)}
        for number in there:
            self.come(f"actor-{number}")

    def come(self, name):
        """Let the process of an actor answer and work."""
        role_spec = self.role_specs[name]
        cars = [SlowCar() for _ in range(self.config.run.cars_per_actor)]
        context = self._context("actor", role_spec.id, role_spec.epoch)
        self.present[name] = Actor(context, cars, NoPictures(), NoScenes())
        self.add(self.present[name])

    def lose(self, name):
        """Let the machine of an actor go away: its successor is ordered, and waits for room."""
        self.remove(self.present.pop(name))
        self.role_specs[name] = RoleSpec("actor", self.role_specs[name].id, self._issue())

    def own(self):
        self.presence.update(self.role_specs.values(), self.present.__contains__, self.now)
        return self.presence.actors, self.presence.left

    def held(self, name):
        """Return the episodes that an actor should drive."""
        return self.scheduler.progress.leases.held_by(name)


@pytest.fixture
def run(tmp_path):
    return lambda **settings: LostRun(tmp_path / "journal", **settings)


def test_a_run_whose_second_actor_never_starts_merges_and_ends(run):
    run = run(there=[0], run={"episodes": 20}, **MERGES)
    summary = run.finish()
    assert run.drivers() == {"actor-0"} and run.merges == 2
    assert run.events["actor_left"] == 0 and summary["transitions"]["low"]["abandoned_at_most"] == 0


def test_one_that_starts_late_drives_from_then_on(run):
    run = run(there=[0], run={"episodes": 30}, **MERGES)
    run.until(lambda: run.merges == 1)
    run.come("actor-1")
    run.finish()
    assert run.drivers() == {"actor-0", "actor-1"}
    assert run.events["actor_replaced"] == run.events["actor_joined"] == 0


def test_a_run_without_any_actor_waits_for_one(run):
    run = run(there=[])
    run.wait(60.0)
    assert run.stage is Stage.TRAIN and run.scheduler.finished_episodes == 0
    run.come("actor-1")
    run.finish()


def test_the_episodes_of_a_lost_actor_are_driven_elsewhere_at_once(run):
    run = run()
    run.until(lambda: run.held("actor-1") and run.present["actor-1"].env_steps > 5)
    run.lose("actor-1")
    run.wait(1.0)
    assert run.held("actor-1") == [] and run.events["actor_left"] == 1
    run.finish()


@pytest.mark.parametrize("merging", [False, True])
def test_a_lost_actor_holds_up_no_merge_and_drives_once_it_is_back(run, merging):
    run = run(run={"episodes": 50}, **MERGES)
    run.until(lambda: run.merging is merging and run.present["actor-1"].actions > 30)
    run.lose("actor-1")
    lost_s, merges = run.now, run.merges
    run.until(lambda: run.merges == merges + 1)
    assert run.now - lost_s < 10.0
    run.come("actor-1")
    run.until(lambda: run.present["actor-1"].env_steps > 5)
    run.finish()
    assert run.events["actor_left"] == run.events["actor_replaced"] == 1 and run.events["actor_joined"] == 0


def test_a_run_that_is_interrupted_does_not_wait_for_a_lost_actor(run):
    run = run()
    run.until(lambda: run.present["actor-1"].env_steps > 5)
    run.lose("actor-1")
    run.interrupted = True
    run.wait(1.0)
    run.finish()
    assert run.now < 60.0


def test_machines_come_and_go_all_the_time_and_the_books_balance(run):
    rng, run = np.random.default_rng(0), run(run={"episodes": 50}, **MERGES)
    while run.stage is not Stage.DONE:
        name = f"actor-{rng.integers(2)}"
        run.lose(name) if name in run.present else run.come(name)
        end_s = run.now + float(rng.uniform(0.1, 3.0))
        run.until(lambda: run.now >= end_s or run.stage is Stage.DONE)  # noqa: B023 (called at once)
    run.finish()
    assert run.events["actor_left"] > 3 < run.events["actor_replaced"]
