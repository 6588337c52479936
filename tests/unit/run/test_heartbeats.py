import pytest

from zsdist.run.heartbeats import (
    HUB,
    HUNG_S,
    HUNG_START_S,
    PAUSE_S,
    SILENT_S,
    STOPPED_S,
    UNSEEN_S,
    UNSEEN_START_S,
    UNSEEN_WITHOUT_ROOM_S,
    Heartbeats,
    Pulse,
)

NAMES = (HUB, "learner-low", "actor-0", "scheduler-0")
ROUND_S = 0.25
STOPPED = Pulse(True, 7)


class Watch:
    """Run in virtual time, in which some roles are silent; the test says how their processes look."""

    def __init__(self):
        self.now = 0.0
        self.heartbeats = Heartbeats(self.now)
        self.silent, self.pulses, self.movement, self.room = set(), {}, 0, True
        for epoch, name in enumerate(NAMES):
            self.heartbeats.expect(name, epoch, self.now)
        self.ride(1.0)

    def ride(self, seconds):
        """Let time pass; return the first role that has to be replaced, with the time and the reason."""
        end = self.now + seconds
        while self.now < end:
            self.now += ROUND_S
            self.movement += 1
            for epoch, name in enumerate(NAMES):
                if name not in self.silent:
                    self.heartbeats.hear(name, epoch, self.now)
            for name in self.heartbeats.silent(self.now):
                pulse = self.pulses.get(name, Pulse(False, self.movement))
                if (reason := self.heartbeats.verdict(name, pulse, self.now, lambda: self.room)) is not None:
                    return name, self.now, reason
        return None


@pytest.fixture
def watch():
    return Watch()


@pytest.mark.parametrize("name", NAMES)
def test_a_role_whose_process_is_stopped_is_found_within_four_seconds(watch, name):
    stopped_s = watch.now
    watch.silent, watch.pulses = {name} if name != HUB else set(NAMES), {name: STOPPED}
    found, at_s, reason = watch.ride(60.0)
    assert found == name and at_s - stopped_s <= STOPPED_S + ROUND_S < 4.0
    assert reason.startswith("its process was stopped for 3 s")


def test_a_role_whose_thread_hangs_is_found_within_nine_seconds(watch):
    hung_s = watch.now
    watch.silent, watch.pulses = {"learner-low"}, {"learner-low": Pulse(False, 5)}
    found, at_s, reason = watch.ride(60.0)
    assert found == "learner-low" and at_s - hung_s <= SILENT_S + HUNG_S + ROUND_S < 9.0
    assert reason == "it hung for 6 s"


def test_a_role_that_waits_for_a_processor_is_never_replaced(watch):
    watch.silent, watch.pulses = {"learner-low"}, {"learner-low": Pulse(False, 7, wants_processor=True)}
    assert watch.ride(10 * HUNG_S) is None


def test_a_role_that_computes_is_never_replaced(watch):
    watch.silent = {"learner-low", "actor-0"}
    assert watch.ride(3600.0) is None


def test_a_short_stop_changes_nothing(watch):
    for _ in range(100):
        watch.silent, watch.pulses = {"actor-0"}, {"actor-0": STOPPED}
        assert watch.ride(STOPPED_S - 2 * ROUND_S) is None
        watch.silent, watch.pulses = set(), {}
        assert watch.ride(1.0) is None


def test_while_the_hub_is_silent_nobody_else_is_blamed(watch):
    watch.silent = set(NAMES)
    watch.pulses = dict.fromkeys(NAMES[1:], Pulse(False, 5))  # they wait for one another
    assert watch.ride(600.0) is None
    watch.silent = set(NAMES[1:])  # the hub is back, and the others have not connected yet
    assert watch.ride(HUNG_S - 1.0) is None


def test_after_a_replacement_of_the_hub_the_others_get_time_to_connect(watch):
    watch.silent, watch.pulses = set(NAMES), {HUB: STOPPED}
    found, at_s, _ = watch.ride(60.0)
    watch.heartbeats.expect(found, 99, at_s)
    watch.pulses = {"actor-0": Pulse(False, 5)}
    assert watch.ride(SILENT_S) is None


def test_a_watcher_that_was_stopped_itself_blames_nobody(watch):
    watch.now += 3600.0
    watch.pulses = dict.fromkeys(NAMES, STOPPED)
    watch.silent = set(NAMES)
    assert watch.ride(PAUSE_S) is None


def test_words_of_an_older_incarnation_do_not_count(watch):
    watch.heartbeats.expect("actor-0", 50, watch.now)
    watch.pulses = {"actor-0": STOPPED}
    found, *_ = watch.ride(60.0)
    assert found == "actor-0"
    assert not watch.heartbeats.hear("actor-0", 2, watch.now)
    assert not watch.heartbeats.hear("stranger-0", 2, watch.now)
    assert watch.heartbeats.hear("actor-0", 50, watch.now)  # its first
    assert not watch.heartbeats.hear("actor-0", 50, watch.now)


def test_a_start_may_take_its_time(watch):
    watch.heartbeats.expect("learner-low", 50, watch.now)
    watch.pulses = {"learner-low": Pulse(False, 5)}
    started_s = watch.now
    found, at_s, _ = watch.ride(600.0)
    assert found == "learner-low" and at_s - started_s > HUNG_START_S


@pytest.mark.parametrize(("name", "patience_s"), [("actor-0", UNSEEN_S["actor"]), ("learner-low", UNSEEN_S["learner"])])
def test_a_role_on_another_machine_is_given_up_after_a_long_silence_only(watch, name, patience_s):
    watch.silent, watch.pulses = {name}, {name: None}
    silent_s = watch.now
    found, at_s, reason = watch.ride(600.0)
    assert found == name and patience_s <= at_s - silent_s <= patience_s + ROUND_S
    assert reason == f"nothing was heard of it for {patience_s:.0f} s"


def test_an_actor_whose_machine_is_cut_off_is_waited_for_while_no_other_has_room(watch):
    watch.silent, watch.pulses, watch.room = {"actor-0"}, {"actor-0": None}, False
    silent_s = watch.now
    assert watch.ride(UNSEEN_WITHOUT_ROOM_S - 2 * ROUND_S) is None
    found, at_s, _ = watch.ride(600.0)
    assert found == "actor-0" and at_s - silent_s <= UNSEEN_WITHOUT_ROOM_S + ROUND_S


def test_it_is_replaced_at_once_where_another_machine_gets_room_meanwhile(watch):
    watch.silent, watch.pulses, watch.room = {"actor-0"}, {"actor-0": None}, False
    assert watch.ride(UNSEEN_S["actor"] + 5.0) is None
    watch.room = True
    assert watch.ride(2 * ROUND_S)[0] == "actor-0"


def test_a_role_on_another_machine_may_take_minutes_to_start_once_its_process_is_there(watch):
    watch.silent, watch.pulses = {"actor-0"}, {"actor-0": None}
    watch.heartbeats.expect("actor-0", 50, watch.now)
    assert watch.ride(UNSEEN_START_S - 1.0) is None  # it may have waited for room
    watch.heartbeats.note_process("actor-0", watch.now)
    there_s = watch.now
    found, at_s, _ = watch.ride(600.0)
    assert found == "actor-0" and UNSEEN_START_S <= at_s - there_s <= UNSEEN_START_S + ROUND_S


def test_a_role_that_has_finished_is_watched_no_longer(watch):
    watch.heartbeats.forget("actor-0")
    watch.silent, watch.pulses = {"actor-0"}, {"actor-0": STOPPED}
    assert watch.ride(60.0) is None
