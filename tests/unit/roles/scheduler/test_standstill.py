import json

from zsdist.roles.scheduler.standstill import STANDSTILL_S, StandstillWatch
from zsdist.telemetry.snapshot import Snapshot
from zsdist.transport.base import Message
from zsdist.wire import keys


def report(snapshot, role, identifier, **fields):
    about = {"time_s": 1.0, "role": role, "id": identifier, "host": "here", "pid": 1}
    snapshot.update([Message(keys.stats("run", role, identifier), json.dumps(about | fields).encode())])


class Watched:
    def __init__(self):
        self.snapshot, self.watch, self.events = Snapshot(), StandstillWatch(), []

    def look(self, now):
        self.watch.watch(now, self.snapshot, lambda now, event, **fields: self.events.append((event, fields)))


def standing():
    watched = Watched()
    report(watched.snapshot, "actor", "0", actions=7, cars_driving=2, cars_waiting_credit=2)
    report(watched.snapshot, "learner", "low", learner_updates=3)
    report(watched.snapshot, "replay", "0", low_transitions_lacking=4, low_size=90)
    watched.look(0.0)
    return watched


def test_a_standstill_is_reported_with_who_waits_for_what():
    watched = standing()
    watched.look(STANDSTILL_S - 1)
    assert not watched.events
    watched.look(STANDSTILL_S + 1)
    ((name, fields),) = watched.events
    assert name == "standstill" and fields["in_flight"] == 0
    assert fields["waits"] == (
        "2 of 2 driving cars for credit; learner high to report; learner low for 4 more transitions (90 are held)"
    )
    assert len(fields["waits"]) <= 200  # longer words are no statistics


def test_a_standstill_that_lasts_is_reported_again_but_not_all_the_time():
    watched = standing()
    for now in range(0, int(3 * STANDSTILL_S) + 2):
        watched.look(float(now))
    assert len(watched.events) == 3


def test_any_progress_counts():
    for role, identifier, name in (
        ("actor", "0", "actions"),
        ("learner", "low", "learner_updates"),
        ("scheduler", "0", "episodes"),
    ):
        watched = standing()
        for step in range(1, 10):
            report(watched.snapshot, role, identifier, **{name: 10 + step})
            watched.look(step * STANDSTILL_S * 0.9)
        assert not watched.events
