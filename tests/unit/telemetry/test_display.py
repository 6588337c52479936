import io
import json

import pytest

from zsdist.common.console import PlainConsole
from zsdist.telemetry import display as displays
from zsdist.telemetry.display import Display
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.wire import keys

RUN = "test"


class Watched:
    """Run that publishes the statistics of a test, with a display of them."""

    def __init__(self, monkeypatch, **options):
        self.now_s = 100.0
        monkeypatch.setattr(displays.time, "monotonic", lambda: self.now_s)
        broker = MemoryBroker()
        self.publisher, self.subscriber = MemoryTransport(broker), MemoryTransport(broker)
        self.output = io.StringIO()
        self.display = Display(RUN, PlainConsole(file=self.output, width=120, **options))
        self.display.update(self.subscriber)

    def publish(self, role, identifier, **fields):
        about = {"time_s": self.now_s, "role": role, "id": identifier, "epoch": 1}
        self.publisher.publish(keys.stats(RUN, role, identifier), json.dumps(about | fields).encode())

    def refresh(self):
        self.display.refresh(self.subscriber, self.now_s)
        return self.output.getvalue()


@pytest.fixture
def watched(monkeypatch):
    return Watched(monkeypatch)


def test_figures_are_shown_under_their_headings(watched):
    watched.publish("scheduler", "0", stage="merge", episodes=7, episodes_target=20, drives_left=3, epsilon=0.25,
                    recent_success=0.5, success=4, collision=2, timeout=1, merges=1, restarts=2)  # fmt: skip
    watched.publish("learner", "low", weight_version=9, learner_updates=30, loss=0.125)
    watched.publish("actor", "0", low_weight_version=7, env_steps=120)
    watched.publish("replay", "0", low_size=50, low_batch_size=16)
    watched.publisher.declare_alive(keys.alive(RUN, "actor", "0"))
    watched.display.update(watched.subscriber)
    shown = watched.display.figures()
    assert shown["episodes"] == "7/20" and shown["stage"] == "merge, 3 drives left"
    assert shown["success, last 50"] == "0.50" and shown["success collision timeout"] == "4 2 1"
    assert shown["epsilon"] == "0.25" and shown["loss low"] == "0.1250" and shown["loss high"] == "-"
    assert shown["updates"] == "high 0 low 30" and shown["weight lag"] == "high 0 low 2"
    assert shown["replay"] == "high 0 low 50" and shown["batch"] == "16"
    assert shown["merges"] == "1" and shown["restarts"] == "2" and shown["roles alive"] == "1"
    assert shown["waiting"] == "nothing"


def test_before_any_statistics_every_heading_has_a_text(watched):
    shown = watched.display.figures()
    assert shown["episodes"] == "0/?" and shown["stage"] == "starting" and shown["return"] == "-"
    assert all(shown.values())


def test_lines_are_printed_from_the_first_statistics_on_and_not_too_often(watched):
    assert watched.refresh() == ""
    watched.publish("scheduler", "0", stage="train", episodes=1)
    assert watched.refresh().count("\n") == 1
    assert "episodes 1/?" in watched.output.getvalue() and "[   0.0 s]" in watched.output.getvalue()
    watched.now_s += displays.LINE_EVERY_S / 2
    assert watched.refresh().count("\n") == 1
    watched.now_s += displays.LINE_EVERY_S
    assert watched.refresh().count("\n") == 2


def test_a_table_has_all_figures_and_the_last_events_as_plain_text(watched):
    for number in range(5):
        event = {"event": "merge", "chosen": f"[red]{number}", "host": "h", "time_s": 1.0}
        watched.publisher.publish(keys.events(RUN), json.dumps(event).encode())
    watched.display.update(watched.subscriber)
    watched.display.console.print(watched.display.table())
    text = watched.output.getvalue()
    assert all(heading in text for heading in watched.display.figures())
    assert [f"chosen=[red]{number}" in text for number in range(5)] == [False, False, True, True, True]
    assert "host=" not in text


def test_a_terminal_gets_a_live_table_and_no_lines(monkeypatch):
    watched = Watched(monkeypatch, force_terminal=True)
    with watched.display:
        watched.publish("scheduler", "0", stage="train", episodes=12)
        text = watched.refresh()
    assert "12/?" in text and "episodes 12/?" not in text


def test_a_stage_says_which_states_it_waits_for(watched):
    watched.publish("scheduler", "0", stage="merge", drives_left=0, states_awaited="replay-0 learner-low")
    watched.display.update(watched.subscriber)
    assert watched.display.figures()["stage"] == "merge, saving: replay-0 learner-low not there yet"


@pytest.mark.parametrize("terminal", [False, True])
def test_a_standstill_is_printed_once_for_each_event(monkeypatch, terminal):
    watched = Watched(monkeypatch, force_terminal=terminal)
    about = {"event": "standstill", "waits": "2 of 2 driving cars for credit", "in_flight": 0}
    for time_s, since_s in ((200.0, 60.0), (260.0, 120.0)):
        event = about | {"time_s": time_s, "since_s": since_s}
        watched.publisher.publish(keys.events(RUN), json.dumps(event).encode())
        watched.refresh()
        shown = watched.refresh()
        assert shown.count(f"nothing has moved for {since_s} s: waiting are 2 of 2 driving cars for credit; 0") == 1


def test_an_event_with_strange_fields_is_not_printed(watched):
    watched.publisher.publish(keys.events(RUN), json.dumps({"event": "standstill", "time_s": "soon"}).encode())
    assert "nothing has moved" not in watched.refresh()


def test_rates_of_the_past_are_not_shown_and_the_silence_is(watched):
    for second in range(3):
        watched.now_s = 100.0 + second
        watched.publish("actor", "0", env_steps=40 * second)
        watched.publish("learner", "low", learner_updates=30 * second, waiting_data_s=0.9 * second)
        watched.display.update(watched.subscriber)
    shown = watched.display.figures()
    assert shown["env steps"] == "0 (40/s)" and "low 30" in shown["updates/s"] and "learner low" in shown["waiting"]
    watched.now_s += 25.0
    shown = watched.display.figures()
    assert shown["env steps"] == "0" and shown["updates/s"] == shown["roles alive"] == "-"
    assert "25 s ago" in shown["waiting"] and "learner" not in shown["waiting"]
    assert watched.display.line().startswith("[   2.0 s]")


def test_after_the_end_nothing_is_waited_for_and_the_clock_stands(watched):
    watched.publish("scheduler", "0", stage="done", episodes=9)
    watched.publish("learner", "low", learner_updates=30, waiting_data_s=0.0)
    watched.now_s += 1.0
    watched.publish("learner", "low", learner_updates=30, waiting_data_s=1.0)
    watched.display.update(watched.subscriber)
    watched.now_s += 60.0
    assert watched.display.done and watched.display.figures()["waiting"] == "nothing: the run has ended"
    assert watched.display.line().startswith("[   1.0 s]")


def test_the_clock_counts_from_the_start_of_the_run_where_that_is_known(monkeypatch):
    monkeypatch.setattr(displays.time, "time", lambda: 1000.0)
    assert Display(RUN, PlainConsole(file=io.StringIO()), started_s=940.0).line().startswith("[  60.")
