import json
import threading

import pytest
from made_cars import RUN, MadeUpRun

from zsdist.errors import TransportError
from zsdist.telemetry import watching
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.web import live
from zsdist.web.live import LiveRun


class Stage:
    """A made-up run in memory, and the live view of it."""

    def __init__(self, cars=4):
        self.broker = MemoryBroker()
        self.run = MadeUpRun(MemoryTransport(self.broker), cars)
        self.connections, self.missing = [], ""
        self.live = LiveRun("Demo", self.connect, lambda view: {"attended": view["car"]})

    def connect(self):
        if self.missing:
            raise TransportError(self.missing)
        self.connections.append(MemoryTransport(self.broker))
        return RUN, self.connections[-1]

    def until(self, condition, car=""):
        """Look again and again until a condition holds for what is shown."""
        for _ in range(400):
            self.run.step()
            shown = json.loads(self.live.look(car))
            if condition(shown):
                return shown
            threading.Event().wait(0.02)
        raise AssertionError(f"not shown: {shown}")

    def unwatched(self):
        """Let the run go on until the view has left it."""
        for _ in range(400):
            self.run.step()
            if not self.live.watched:
                return True
            threading.Event().wait(0.02)
        return False


@pytest.fixture
def stage(monkeypatch):
    monkeypatch.setattr(live, "EVERY_S", 0.05)
    monkeypatch.setattr(live, "LOOKING_S", 0.5)
    monkeypatch.setattr(live, "RETRY_EVERY_S", 0.02)
    stage = Stage()
    yield stage
    assert stage.unwatched()


def test_a_look_shows_roles_figures_events_and_where_all_cars_are(stage):
    stage.until(lambda shown: shown["state"].get("figures", {}).get("stage"))
    stage.run.event("role_replaced", name="actor-0")
    shown = stage.until(lambda shown: shown["state"].get("actors") and shown["state"]["events"])["state"]
    assert (shown["run"], shown["key"], shown["figures"]["stage"]) == ("Demo", RUN, "train")
    assert {(role["role"], role["id"]) for role in shown["roles"]} == set(stage.run.roles())
    assert all(role["alive"] for role in shown["roles"])
    assert [car["car"] for actor in map(json.loads, shown["actors"]) for car in actor["cars"]] == [0, 1, 2, 3]
    assert shown["events"][0]["event"] == "role_replaced"


def test_a_close_look_at_a_car_comes_with_what_is_added_to_it(stage):
    shown = stage.until(lambda shown: shown["view"], car="actor-0/2")
    assert (shown["view"]["car"], shown["view"]["attended"]) == (2, 2)
    assert stage.until(lambda shown: shown["state"].get("actors"))["view"] is None


def test_nothing_is_connected_or_asked_before_a_look_and_after_the_last_one(stage):
    stage.run.step()
    assert (stage.connections, stage.run.asked, stage.live.watched) == ([], 0, False)
    stage.until(lambda shown: shown["state"].get("actors"))
    assert stage.unwatched()
    with pytest.raises(TransportError):
        stage.connections[0].declare_alive("zsdist/demo/alive/actor/9")
    stage.run.step()
    asked = stage.run.asked
    for _ in range(10):
        threading.Event().wait(0.02)
        stage.run.step()
    assert stage.run.asked == asked
    stage.until(lambda shown: shown["state"].get("actors"))
    assert len(stage.connections) == 2, "a new look connects again"


def test_a_run_that_cannot_be_reached_is_said_and_tried_again(stage):
    stage.missing = "the run is starting"
    shown = stage.until(lambda shown: shown["state"]["status"] == "waiting")
    assert shown["state"]["told"] == "the run is starting"
    stage.missing = ""
    stage.until(lambda shown: shown["state"]["status"] == "live")


def test_the_snapshot_is_that_of_the_monitor(stage):
    pumping = threading.Event()

    def pump():
        while not pumping.wait(0.02):
            stage.run.step()

    thread = threading.Thread(target=pump)
    thread.start()
    found = stage.live.snapshot(5.0)
    pumping.set()
    thread.join()
    assert found.keys() == watching.snapshot_fields(RUN, live.Snapshot()).keys()
    assert found["run"] == RUN and found["alive"] == sorted("/".join(role) for role in stage.run.roles())


@pytest.mark.parametrize("payload", [b"", b"{", b"[1]", b'{"a": NaN}', b'{"a": Infinity}', b"\xff"])
def test_an_answer_that_a_browser_could_not_read_is_left_out(payload):
    assert live.read_answer(payload) is None


def test_what_actors_answer_is_a_text_to_the_page_whatever_it_is():
    assert json.loads(live.quote(b'{"a": NaN')) == '{"a": NaN'
    assert live.quote(b"\xff") is live.quote(b" " * (live.MOST_BYTES + 1)) is None


def test_an_answer_without_a_bound_is_left_out():
    assert live.read_answer(b'{"a":1}') == {"a": 1}
    assert live.read_answer(b'{"a":"%b"}' % (b"x" * live.MOST_BYTES)) is None
