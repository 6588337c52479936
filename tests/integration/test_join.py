"""A real run that actors join from another process over TLS, drive for, and leave; the cars are kinematic."""

import json
import multiprocessing
import threading
import time
from contextlib import contextmanager

import pytest
from rehearsal import kinematic, rehearse, start
from sockets import free_endpoint

from zsdist.errors import RunError, TransportError
from zsdist.roles import permissions
from zsdist.run import join
from zsdist.run.join import Party
from zsdist.telemetry.snapshot import Snapshot
from zsdist.transport import certificates
from zsdist.transport.base import Mailbox
from zsdist.wire import keys

pytestmark = [pytest.mark.integration, pytest.mark.alone, pytest.mark.timeout(600)]

PATIENCE_S = 200.0  # a busy machine takes long to import what a process needs


class Run:
    """Run of one actor of its own in a thread of this process, until it is told to end."""

    def __init__(self, folder, *overrides):
        many = (
            "run.episodes=100000",
            "run.checkpoint_every_episodes=100000",
            "merge.every_episodes=0",
            "run.actors=1",
            "vision.cache_bytes=0",
        )
        self.spec = start(folder, "transport.kind=zenoh", *many, *overrides)
        self.snapshot, self.error = Snapshot(), None
        self._ends, self._box, self._listening = threading.Event(), Mailbox(2**24), False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        try:
            self.summary = rehearse(self.spec, interrupted=self._ends.is_set, watch=self._watch)
        except Exception as error:
            self.error = error

    def _watch(self, transport, now):
        if not self._listening:
            self._listening = True
            transport.subscribe(keys.stats(self.spec.run, keys.ANY, keys.ANY), self._box)
            transport.subscribe(keys.events(self.spec.run), self._box)
        self.snapshot.update(self._box.drain())

    @property
    def endpoint(self):
        until(lambda: (self.spec.folder / "endpoint").exists() and self.snapshot.of("scheduler"), self)
        return (self.spec.folder / "endpoint").read_text()

    def episodes_of(self, actor):
        lines = (self.spec.folder / "episodes.jsonl").read_text().splitlines()
        return sum(json.loads(line)["actor"] == actor for line in lines if line.endswith("}"))

    def events(self):
        return [event["event"] for event in self.snapshot.events]

    def end(self):
        self._ends.set()
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive() and self.error is None, self.error
        for level, books in self.summary["transitions"].items():
            assert books["produced"] == books["stored"] + books["rejected"], level
        return self.summary


def until(condition, run):
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s and run.error is None, f"it does not happen: {run.error}"
        time.sleep(0.05)


@contextmanager
def taking_part(party):
    """Let a party take part in a thread; yield the function that interrupts it, and its end."""
    stop, errors = threading.Event(), []

    def take_part():
        try:
            party.take_part(stop.is_set)
        except Exception as error:
            errors.append(error)

    thread = threading.Thread(target=take_part)
    thread.start()

    def end(interrupt=True):
        if interrupt:
            stop.set()
        thread.join(PATIENCE_S)
        assert not thread.is_alive() and not errors, errors

    try:
        yield end
    finally:
        stop.set()
        thread.join(PATIENCE_S)


def test_actors_join_over_tls_drive_and_are_taken_away_again(tmp_path):
    everything, elsewhere = tmp_path / "tls", tmp_path / "elsewhere"
    certificates.make(everything, permissions.HUB, permissions.client_names(8), ["127.0.0.1"], days=1)
    elsewhere.mkdir()
    for name in ("ca.pem", "actor-5.pem", "actor-5.key", "actor-7.pem", "actor-7.key"):
        (elsewhere / name).write_bytes((everything / name).read_bytes())
    run = Run(tmp_path / "run", f"transport.tls={everything}", f"transport.endpoint={free_endpoint('tls')}")
    try:
        lines = []
        with pytest.raises(TransportError, match=r"has certificates of 2 actors and --actors is 3"):
            Party(run.endpoint, elsewhere, 3)
        with taking_part(Party(run.endpoint, elsewhere, 1, notify=lines.append, make_parts=kinematic)) as end:
            until(lambda: run.episodes_of("actor-5"), run)
            (child,) = multiprocessing.active_children()
            child.kill()  # it comes back under a new epoch
            before = run.episodes_of("actor-5")
            until(lambda: run.episodes_of("actor-5") > before, run)
            end()
        assert not multiprocessing.active_children()
        assert any("died" in line for line in lines) and lines[-1].startswith("left run run; ")
        until(lambda: run.events()[-1] == "actor_left", run)
        assert run.events()[0] == "actor_joined"
        with taking_part(Party(run.endpoint, elsewhere, 2, notify=lines.append, make_parts=kinematic)) as end:
            until(lambda: run.episodes_of("actor-7"), run)
            with pytest.raises(RunError, match="--actors is 1; allowed is at most 0"):
                Party(run.endpoint, elsewhere, 1).take_part(lambda: False)
            summary = run.end()
            end(interrupt=False)
        assert lines[-1].startswith("run run has ended; ")
    finally:
        run.end()
    assert summary["restarts"] == {"actor": 0}
    assert run.episodes_of("actor-0") and run.episodes_of("actor-5") and run.episodes_of("actor-7")


def test_a_run_of_another_version_or_vision_is_refused_with_both_values(tmp_path, monkeypatch):
    run = Run(tmp_path / "run", f"transport.endpoint={free_endpoint()}")
    try:
        with pytest.raises(Exception, match=r"the vision model here is .*; allowed is that of run run, "):
            Party(run.endpoint, None, 1).take_part(lambda: False)
        monkeypatch.setattr(join, "__version__", "9.9.9")
        with pytest.raises(RunError, match=r"is driven by zsdist 0\.1\.0 and this is zsdist 9\.9\.9"):
            Party(run.endpoint, None, 1, make_parts=kinematic).take_part(lambda: False)
    finally:
        run.end()
