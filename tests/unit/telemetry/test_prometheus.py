import json
import re
import threading
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families
from sockets import free_endpoint

import zsdist
from zsdist.common.http_address import HttpAddress
from zsdist.errors import RunError
from zsdist.telemetry import prometheus
from zsdist.telemetry.prometheus import Exporter
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Outcome
from zsdist.wire import keys

RUN = "demo"
ABOUT = {"time_s": 1.0, "host": "pc-7", "pid": 1, "epoch": 3}
STATISTICS = {
    ("actor", "0"): {"env_steps": 7, "cars": 4, "waiting_credit_s": 1.5, "high_produced": 5, "low_produced": 9},
    ("learner", "low"): {"learner_updates": 12, "loss": 0.25, "weight_version": 3},
    ("replay", "0"): {"low_size": 400, "low_stored": 500, "journal_bytes": 4096, "low_refused_closed_epoch": 2},
    ("scheduler", "0"): {"stage": "train", "episodes": 3, "recent_success": 0.5},
    ("hub", "0"): {"endpoint": "tcp/127.0.0.1:7447", "cpu_s": 2.5, "peak_kib": 2},
}


class Scraped:
    """What a reading of the page has shown."""

    def __init__(self, text: str) -> None:
        self.families = {family.name: family for family in text_string_to_metric_families(text)}
        self.samples = [sample for family in self.families.values() for sample in family.samples]

    def value(self, name: str, **labels: str) -> float:
        (found,) = [s.value for s in self.samples if s.name == name and labels.items() <= s.labels.items()]
        return found

    def has(self, name: str, **labels: str) -> bool:
        return any(s.name == name and labels.items() <= s.labels.items() for s in self.samples)


class Watched:
    """A run whose roles report when they are told to, and the exporter that watches it."""

    def __init__(self, broker: MemoryBroker, where: HttpAddress) -> None:
        self.broker, self.where = broker, where
        self.speaker = MemoryTransport(broker)
        self.there = threading.Event()
        self.asked = threading.Event()

    def find(self) -> tuple[str, MemoryTransport]:
        self.asked.set()
        if not self.there.is_set():
            raise RunError("there is no run yet")
        return RUN, MemoryTransport(self.broker)

    def report(self, role: str, identifier: str, **fields: float | str) -> None:
        about = {**ABOUT, "role": role, "id": identifier}
        payload = json.dumps({**about, **fields}).encode()
        self.speaker.publish(keys.stats(RUN, role, identifier), payload, json=True)

    def event(self, event: str, **fields: float | str) -> None:
        payload = json.dumps({**ABOUT, "role": "scheduler", "id": "0", "event": event, **fields}).encode()
        self.speaker.publish(keys.events(RUN), payload, json=True)

    def scrape(self) -> Scraped:
        with urllib.request.urlopen(self.where.url("metrics"), timeout=10) as page:
            return Scraped(page.read().decode())

    def scrape_until(self, condition) -> Scraped:
        for _ in range(200):
            if condition(scraped := self.scrape()):
                return scraped
            threading.Event().wait(0.02)
        raise AssertionError("the page does not show what was reported")


@pytest.fixture
def watched(monkeypatch) -> Iterator[Watched]:
    monkeypatch.setattr(prometheus, "RETRY_EVERY_S", 0.05)
    monkeypatch.setattr(prometheus, "RECEIVE_EVERY_S", 0.02)
    where = HttpAddress("127.0.0.1", int(free_endpoint().rpartition(":")[2]))
    run, over = Watched(MemoryBroker(), where), threading.Event()
    with Exporter(where) as exporter:
        thread = threading.Thread(target=exporter.serve, args=(run.find, over.is_set))
        thread.start()
        yield run
        over.set()
        thread.join()


def all_report(watched: Watched) -> Scraped:
    watched.there.set()
    watched.speaker.declare_alive(keys.alive(RUN, "actor", "0"))

    def reported(scraped: Scraped) -> bool:
        for (role, identifier), fields in STATISTICS.items():
            watched.report(role, identifier, **fields)
        return all(scraped.has(f"zsdist_{name}") for name in ("hub_cpu_seconds_total", "actor_cars", "run_stage"))

    return watched.scrape_until(reported)


def test_every_number_that_roles_report_is_read_with_its_run_host_role_and_level(watched):
    scraped = all_report(watched)
    assert scraped.value("zsdist_up") == 1
    assert scraped.value("zsdist_actor_env_steps_total", run=RUN, host="pc-7", id="0") == 7
    assert scraped.value("zsdist_actor_produced_total", level="low", id="0") == 9
    assert scraped.value("zsdist_actor_produced_total", level="high", id="0") == 5
    assert scraped.value("zsdist_learner_loss", level="low") == 0.25
    assert scraped.value("zsdist_replay_size", level="low", id="0") == 400
    assert scraped.value("zsdist_replay_refused_closed_epoch_total", level="low") == 2
    assert scraped.value("zsdist_scheduler_recent_success") == 0.5
    assert scraped.value("zsdist_run_stage", stage="train") == 1
    assert scraped.value("zsdist_role_alive", role="actor", id="0") == 1
    assert scraped.value("zsdist_weight_lag_versions", level="low") == 0


def test_units_are_those_of_prometheus(watched):
    scraped = all_report(watched)
    assert scraped.value("zsdist_actor_waiting_credit_seconds_total") == 1.5
    assert scraped.value("zsdist_hub_peak_bytes") == 2048
    assert scraped.value("zsdist_replay_journal_bytes") == 4096
    assert not any(name.endswith(("_s", "_kib")) for name in scraped.families)


def test_what_only_grows_is_a_counter_and_the_rest_a_gauge(watched):
    kinds = {name: family.type for name, family in all_report(watched).families.items()}
    assert kinds["zsdist_actor_env_steps"] == kinds["zsdist_learner_learner_updates"] == "counter"
    assert kinds["zsdist_actor_cars"] == kinds["zsdist_learner_weight_version"] == kinds["zsdist_up"] == "gauge"


def test_a_role_that_is_silent_has_no_metrics_and_a_silent_run_is_not_up(watched, monkeypatch):
    all_report(watched)
    monkeypatch.setattr(prometheus, "SILENT_AFTER_S", 0.2)
    silent = watched.scrape_until(lambda scraped: scraped.value("zsdist_up") == 0)
    assert not silent.has("zsdist_actor_cars")
    assert all_report(watched).value("zsdist_up") == 1


def test_a_run_is_waited_for_and_the_page_says_meanwhile_that_there_is_none(watched):
    assert watched.asked.wait(10)
    scraped = watched.scrape()
    assert scraped.value("zsdist_up") == 0 and set(scraped.families) == {"zsdist_up"}


def test_a_run_that_ends_is_left_and_the_next_one_is_watched(watched):
    all_report(watched)
    watched.there.clear()
    watched.report("scheduler", "0", stage="done")
    watched.scrape_until(lambda scraped: scraped.value("zsdist_up") == 0)
    all_report(watched)


def test_each_event_counts_once(watched):
    all_report(watched)
    for _ in range(2):
        watched.event("role_replaced", name="actor-0", reason="it died")
    watched.event("Not a metric's label\n")
    counted = lambda scraped: scraped.has("zsdist_events_total", event="role_replaced")  # noqa: E731
    watched.scrape_until(counted)
    for _ in range(3):
        scraped = watched.scrape()
    assert scraped.value("zsdist_events_total") == 2


def test_names_that_no_metric_may_have_are_left_out(watched):
    all_report(watched)
    watched.report("actor", "1", **{"cars": 2, "Bad-Name.x": 1, "_s": 2})
    scraped = watched.scrape_until(lambda scraped: scraped.has("zsdist_actor_cars", id="1"))
    assert {s.labels["id"] for s in scraped.samples if s.name == "zsdist_actor_cars"} == {"0", "1"}


def test_a_port_that_is_taken_is_reported_with_the_address(watched):
    with pytest.raises(RunError, match=f"{watched.where.port}/metrics: .*in use"), Exporter(watched.where):
        pass


def test_every_counter_is_a_field_that_some_role_reports():
    folder = Path(zsdist.__file__).parent
    sources = "".join(path.read_text() for path in folder.rglob("*.py") if path.parent.name != "telemetry")
    outcomes = {outcome.value for outcome in Outcome}
    assert {name for name in prometheus.COUNTERS - outcomes if not re.search(rf'["_}}]{name}"', sources)} == set()
