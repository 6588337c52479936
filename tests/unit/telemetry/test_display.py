import io
import json
import re

import pytest

from zsdist.common.console import PlainConsole
from zsdist.telemetry import display as displays
from zsdist.telemetry.display import Display
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.wire import keys

RUN = "test"
OPENED, CLOSED = "\x1b[?1049h", "\x1b[?1049l"  # the screen that a terminal keeps for programs that fill it


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


def test_lines_are_printed_from_the_start_on_and_not_too_often(watched):
    assert "starting" in watched.refresh() and watched.output.getvalue().count("\n") == 1
    watched.publish("scheduler", "0", stage="train", episodes=1)
    watched.publish("actor", "0", env_steps=1)
    assert watched.refresh().count("\n") == 2  # the first word is shown at once
    assert "episodes 1/?" in watched.output.getvalue() and "[   0.0 s" in watched.output.getvalue()
    watched.now_s += displays.LINE_EVERY_S / 2
    assert watched.refresh().count("\n") == 2
    watched.now_s += displays.LINE_EVERY_S
    assert watched.refresh().count("\n") == 3


def test_the_last_state_stays_in_lines_too(watched):
    with watched.display:
        watched.publish("scheduler", "0", stage="train", episodes=29, episodes_target=30)
        watched.refresh()
        watched.publish("scheduler", "0", stage="done", episodes=30, episodes_target=30)
        assert "30/30" not in watched.refresh()  # it is not due
    assert "done" in (last := watched.output.getvalue().splitlines()[-1]) and "episodes 30/30" in last


def test_a_run_is_shown_by_the_name_of_its_folder_whatever_characters_that_has():
    output = io.StringIO()
    display = Display(RUN, PlainConsole(file=output, width=120), title="sw[b]x[]")
    display.console.print(display.table())
    assert display.view().run == "sw[b]x[]" and "sw[b]x[]" in output.getvalue() and display.run == RUN


def test_a_table_has_all_figures_and_the_last_events_as_plain_text(watched):
    for number in range(5):
        event = {"event": "merge", "chosen": f"[red]{number}", "host": "h", "time_s": 1.0}
        watched.publisher.publish(keys.events(RUN), json.dumps(event).encode())
    watched.display.update(watched.subscriber)
    watched.display.console.print(watched.display.table())
    text = watched.output.getvalue()
    assert all(heading in text for heading in ("episodes", "stage", "waiting", *watched.display.view().figures))
    assert [f"chosen=[red]{number}" in text for number in range(5)] == [False, False, True, True, True]
    assert "host=" not in text


def test_a_terminal_gets_a_full_screen_and_then_the_last_state_and_what_was_said(monkeypatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    watched = Watched(monkeypatch, force_terminal=True)
    with watched.display:
        watched.publish("scheduler", "0", stage="train", episodes=12)
        text = watched.refresh()
        print("said by somebody")
        watched.display.tell("stopping")
        event = {"event": "role_replaced", "name": "actor-0", "reason": "it died", "time_s": 1.0}
        watched.publisher.publish(keys.events(RUN), json.dumps(event).encode())
        assert "said by somebody" in watched.refresh()
    assert OPENED in text and "12 of ? episodes" in text and "episodes 12/?" not in text
    _, _, after = watched.output.getvalue().rpartition(CLOSED)
    assert all(after.count(line) == 1 for line in ("said by somebody", "stopping", "actor-0 is replaced", "12/?"))


def test_ctrl_c_leaves_a_clean_terminal(monkeypatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    watched = Watched(monkeypatch, force_terminal=True)
    with pytest.raises(KeyboardInterrupt), watched.display:
        watched.refresh()
        raise KeyboardInterrupt
    text = watched.output.getvalue()
    assert text.count(OPENED) == text.count(CLOSED) == 1 and text.rindex("\x1b[?25h") > text.rindex("\x1b[?25l")


def test_no_color_is_honoured(monkeypatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("NO_COLOR", "1")
    watched = Watched(monkeypatch, force_terminal=True)
    with watched.display:
        watched.publish("scheduler", "0", stage="train", episodes=12)
        assert not re.search(r"\x1b\[[0-9;]*[34][0-7]m", watched.refresh())


@pytest.mark.parametrize("wrong", [{"TERM": "dumb"}, {"encoding": "ascii"}])
def test_a_terminal_that_cannot_show_the_screen_gets_lines(monkeypatch, wrong):
    monkeypatch.setenv("TERM", wrong.get("TERM", "xterm"))
    output = io.TextIOWrapper(io.BytesIO(), encoding=wrong.get("encoding", "utf-8"))
    display = Display(RUN, PlainConsole(file=output, force_terminal=True))
    with display:
        display.show()
    output.flush()
    assert b"waiting" in (printed := output.buffer.getvalue()) and OPENED.encode() not in printed


@pytest.mark.parametrize("terminal", [False, True])
def test_a_standstill_is_printed_once_for_each_event(monkeypatch, terminal):
    monkeypatch.setenv("TERM", "xterm-256color")
    watched = Watched(monkeypatch, force_terminal=terminal)
    about = {"event": "standstill", "waits": "2 of 2 driving cars for credit", "in_flight": 0}
    with watched.display:
        for time_s, since_s in ((200.0, 60.0), (260.0, 120.0)):
            event = about | {"time_s": time_s, "since_s": since_s}
            watched.publisher.publish(keys.events(RUN), json.dumps(event).encode())
            watched.refresh()
            watched.refresh()
    shown = watched.output.getvalue().rpartition(CLOSED)[2]
    for since_s in (60.0, 120.0):
        assert shown.count(f"nothing has moved for {since_s} s: waiting are 2 of 2 driving cars for credit; 0") == 1


def test_long_news_are_folded_where_there_are_only_lines(watched):
    event = {"event": "role_replaced", "name": "actor-0", "reason": "because " * 25, "time_s": 1.0}
    watched.publisher.publish(keys.events(RUN), json.dumps(event).encode())
    lines = watched.refresh().splitlines()
    assert max(map(len, lines)) <= 120 and sum(line.count("because") for line in lines) == 25


def test_an_event_with_strange_fields_is_not_printed(watched):
    watched.publisher.publish(keys.events(RUN), json.dumps({"event": "standstill", "time_s": "soon"}).encode())
    assert "nothing has moved" not in watched.refresh()


def test_the_clock_stands_where_nothing_is_heard_any_more(watched):
    watched.now_s += 2.0
    watched.publish("actor", "0", env_steps=40)
    watched.display.update(watched.subscriber)
    watched.now_s += 25.0
    assert watched.display.line().startswith("[   2.0 s") and "25 s ago" in watched.display.line()


def test_nobody_is_called_silent_while_the_display_itself_was_not_called(watched):
    watched.publish("scheduler", "0", stage="train", episodes=1)
    watched.refresh()
    watched.now_s += 19.0  # the run compiles in this process
    assert "the last came" not in watched.refresh()
    for _ in range(40):  # called in time, it hears nothing
        watched.now_s += 0.5
        watched.refresh()
    assert "20 s ago" in watched.display.line()


def test_after_the_end_nothing_is_waited_for_and_the_clock_stands(watched):
    watched.now_s += 1.0
    watched.publish("scheduler", "0", stage="done", episodes=9)
    watched.display.update(watched.subscriber)
    watched.now_s += 60.0
    assert watched.display.done and watched.display.line().startswith("[   1.0 s")
    assert watched.display.line().endswith("waiting nothing: the run has ended")


def test_the_clock_counts_from_the_start_of_the_run_where_that_is_known(monkeypatch):
    monkeypatch.setattr(displays.time, "time", lambda: 1000.0)
    assert Display(RUN, PlainConsole(file=io.StringIO()), started_s=940.0).line().startswith("[  60.")
    assert " s watched]" in Display(RUN, PlainConsole(file=io.StringIO())).line()
