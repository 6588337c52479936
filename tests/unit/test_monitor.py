import contextlib
import json
import os
import signal
import threading
import time
import urllib.request
from contextlib import contextmanager

import pytest
from made_runs import make_run
from rehearsal import SEEN
from sockets import free_endpoint

from zsdist import config, monitor
from zsdist.common import cli, locks
from zsdist.roles import permissions
from zsdist.run.program import RoleSpec, RunSpec
from zsdist.telemetry import view, watching
from zsdist.transport import certificates
from zsdist.transport.zenoh import ZenohHub, ZenohTransport
from zsdist.wire import keys

STATISTICS = {"time_s": 1.0, "role": "actor", "id": "0", "host": "here", "pid": 1, "env_steps": 7}


@pytest.fixture
def hub():
    with ZenohHub("tcp/127.0.0.1:17960") as hub:
        yield hub


@contextmanager
def speaking(transport):
    """Start a role of run `demo` that is alive and reports ten times a second."""
    over = threading.Event()
    transport.declare_alive(keys.alive("demo", "actor", "0"))

    def speak():
        while not over.wait(0.1):
            transport.publish(keys.stats("demo", "actor", "0"), json.dumps(STATISTICS).encode(), json=True)

    thread = threading.Thread(target=speak)
    thread.start()
    yield
    over.set()
    thread.join()
    transport.close()


@pytest.fixture
def speaker(hub):
    with speaking(ZenohTransport(hub.endpoint)):
        yield


def date_back(folder, seconds):
    then = time.time() - seconds
    for file in folder.iterdir():
        os.utime(file, (then, then))


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        cli.execute(monitor.main, monitor.make_parser(), list(map(str, arguments)))
    return ended.value.code, capsys.readouterr()


def test_one_snapshot_is_json_that_names_the_living_roles_and_their_statistics(capsys, hub, speaker):
    status, printed = run(capsys, "--connect", hub.endpoint, "--once", "--json")
    assert status == 0
    snapshot = json.loads(printed.out)
    assert snapshot["run"] == "demo"
    assert snapshot["alive"] == ["actor/0"]
    assert snapshot["roles"]["actor/0"] == STATISTICS
    assert snapshot["figures"]["actors_env_steps"] == 7


def test_the_newest_run_is_found_by_its_endpoint_file(capsys, tmp_path, hub, speaker):
    for name, endpoint in (("old", "tcp/127.0.0.1:1"), ("demo", hub.endpoint)):
        (make_run(tmp_path / name) / "endpoint").write_text(endpoint)
    date_back(tmp_path / "old", 3600)
    status, printed = run(capsys, "--runs", tmp_path, "--once")
    assert status == 0
    assert "env steps" in printed.out


@pytest.mark.parametrize(
    ("arguments", "telling"),
    [
        (["--connect", "tcp/127.0.0.1:1", "--once"], "tcp/127.0.0.1:1"),
        (["--connect", "nonsense", "--once"], "nonsense"),
        (["--runs", "no-such-folder", "--once"], "no-such-folder"),
    ],
)
def test_an_endpoint_without_a_hub_is_reported_in_one_line(capsys, arguments, telling):
    status, printed = run(capsys, *arguments)
    assert status == cli.REFUSED
    assert telling in printed.err
    assert printed.err.count("\n") == 1


def test_figures_are_served_to_prometheus_until_a_signal(capsys, hub, speaker):
    port = free_endpoint().rpartition(":")[2]
    read = []

    def scrape():
        for _ in range(400):
            with contextlib.suppress(OSError):
                read.append(urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10).read().decode())
            if read and "zsdist_actor_env_steps_total{" in read[-1]:
                break
            threading.Event().wait(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    scraping = threading.Thread(target=scrape)
    scraping.start()
    status, printed = run(capsys, "--connect", hub.endpoint, "--prometheus", port)
    scraping.join()
    assert status == 130 and f"metrics at http://127.0.0.1:{port}/metrics" in printed.out
    assert 'zsdist_actor_env_steps_total{host="here",id="0",level="",run="demo"} 7.0' in read[-1]


def test_the_live_view_is_served_in_a_browser_until_a_signal(capsys, hub, speaker):
    port = int(free_endpoint().rpartition(":")[2])
    read = []

    def browse():
        for _ in range(400):
            with contextlib.suppress(OSError):
                page = urllib.request.urlopen(f"http://127.0.0.1:{port}/snapshot.json", timeout=10)
                read.append(json.loads(page.read()))
                break
            threading.Event().wait(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    browsing = threading.Thread(target=browse)
    browsing.start()
    status, printed = run(capsys, "--connect", hub.endpoint, "--web", port)
    browsing.join()
    assert status == 130 and f"live view at http://127.0.0.1:{port}/" in printed.out
    assert f"ssh -N -L {port}:127.0.0.1:{port}" in printed.out
    assert read[0]["run"] == "demo" and read[0]["roles"]["actor/0"] == STATISTICS


@pytest.mark.parametrize("text", ["0", "65536", "-1", "x", "127.0.0.1:80"])
def test_the_live_view_is_for_this_machine_so_that_only_a_port_is_named(capsys, text):
    status, printed = run(capsys, f"--web={text}")
    assert status == cli.REFUSED and repr(text) in printed.err


@pytest.mark.parametrize("option", ["--once", "--json", "--plain"])
def test_an_option_of_the_display_is_refused_where_pages_are_served(capsys, option):
    status, printed = run(capsys, "--web", "8091", option)
    assert status == cli.REFUSED and f"{option} cannot be combined with --web" in printed.err


@pytest.mark.parametrize("option", ["--once", "--json", "--plain"])
def test_an_option_of_the_display_is_refused_where_figures_are_served(capsys, option):
    status, printed = run(capsys, "--prometheus", "9464", option)
    assert status == cli.REFUSED and f"{option} cannot be combined with --prometheus" in printed.err


def test_a_run_that_is_not_there_is_named(capsys, hub, speaker, monkeypatch):
    monkeypatch.setattr(watching, "FIRST_REPORT_WITHIN_S", 0.3)
    status, printed = run(capsys, "--connect", hub.endpoint, "--run", "other", "--once")
    assert status == cli.REFUSED
    assert "'other'" in printed.err


def test_a_monitor_finds_its_certificate_in_the_runs_configuration_or_where_an_option_names_it(capsys, tmp_path):
    certificates.make(tmp_path / "tls", permissions.HUB, permissions.client_names(1), ["127.0.0.1"], days=1)
    folder = tmp_path / "runs" / "demo"
    folder.mkdir(parents=True)
    settings = config.load(None, (f"transport.tls={tmp_path / 'tls'}", f"transport.endpoint={free_endpoint('tls')}"))
    (folder / "config.yaml").write_text(config.dump(settings))
    spec = RunSpec(settings, "demo", folder, {}, SEEN)
    with spec.open_hub() as hub:
        (folder / "endpoint").write_text(hub.endpoint)
        transport = spec.connect(RoleSpec("actor", "0", 1), hub.endpoint)
        with speaking(transport):
            for where in (("--runs", folder.parent), ("--connect", hub.endpoint, "--tls", tmp_path / "tls")):
                status, printed = run(capsys, *where, "--once", "--json")
                assert status == 0
                assert json.loads(printed.out)["roles"]["actor/0"] == STATISTICS
            status, printed = run(capsys, "--connect", hub.endpoint, "--once")
            assert status == cli.REFUSED and "--tls" in printed.err


ENDED = {"ended": "complete", "episodes": 12}


@pytest.mark.parametrize("option", [["--once"], ["--plain"], []])
@pytest.mark.parametrize("endpoint", [None, "tcp/127.0.0.1:1"])
def test_a_run_that_has_ended_is_told_and_the_status_is_0(capsys, tmp_path, option, endpoint):
    folder = make_run(tmp_path / "demo", summary=ENDED)
    if endpoint is not None:
        (folder / "endpoint").write_text(endpoint)
    status, printed = run(capsys, "--runs", tmp_path, *option)
    assert status == 0 and printed.err == ""
    assert "run demo ended at 2" in printed.out and "last seen at 2" in printed.out and printed.out.count("\n") == 1


def test_a_run_that_has_ended_is_told_as_json(capsys, tmp_path):
    make_run(tmp_path / "demo", summary=ENDED)
    status, printed = run(capsys, "--runs", tmp_path, "--once", "--json")
    told = json.loads(printed.out)
    assert status == 0 and told["run"] == "demo" and told["alive"] == [] and told["ended"]["episodes"] == 12


@pytest.mark.parametrize("option", [["--once"], []])
@pytest.mark.parametrize("endpoint", [None, "tcp/127.0.0.1:1"])
def test_a_run_that_was_killed_is_told_and_the_status_is_1(capsys, tmp_path, option, endpoint):
    folder = make_run(tmp_path / "demo")
    if endpoint is not None:
        (folder / "endpoint").write_text(endpoint)
    date_back(folder, 3600)
    status, printed = run(capsys, "--runs", tmp_path, *option)
    assert status == monitor.LOST
    assert "has not ended" in printed.err and "last seen at 2" in printed.err and printed.err.count("\n") == 1


def test_a_run_that_was_killed_is_told_as_json_too(capsys, tmp_path):
    date_back(make_run(tmp_path / "demo"), 3600)
    status, printed = run(capsys, "--runs", tmp_path, "--once", "--json")
    told = json.loads(printed.out)
    assert status == monitor.LOST and told["run"] == "demo" and told["ended"] is None and told["alive"] == []
    assert "has not ended" in printed.err


def test_a_run_that_is_starting_is_waited_for_and_then_shown_until_its_end(capsys, tmp_path, hub):
    folder = make_run(tmp_path / "demo")
    transport = ZenohTransport(hub.endpoint)

    def live():
        (folder / "endpoint").write_text(hub.endpoint)
        scheduler = {"time_s": 1.0, "role": "scheduler", "id": "0", "stage": "train", "episodes": 11}
        for stage in ("train", "train", "done"):
            over.wait(0.7)
            fields = scheduler | {"stage": stage}
            transport.publish(keys.stats("demo", "scheduler", "0"), json.dumps(fields).encode(), json=True)
        (folder / "summary.json").write_text(json.dumps(ENDED))

    over, starts = threading.Event(), threading.Timer(0.7, live)
    starts.start()
    status, printed = run(capsys, "--runs", tmp_path)
    starts.join()
    transport.close()
    first, *shown, last = printed.out.splitlines()
    assert status == 0 and "run demo is starting" in first and "run demo ended at" in last
    assert any("episodes 11" in line for line in shown)


def test_a_run_whose_hub_is_gone_is_left_after_a_while_with_the_time_of_its_last_word(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(watching, "GONE_AFTER_S", 1.5)
    with ZenohHub("tcp/127.0.0.1:17970") as hub, speaking(ZenohTransport(hub.endpoint)):
        end = threading.Timer(1.0, hub.close)
        end.start()
        status, printed = run(capsys, "--connect", hub.endpoint)
        end.join()
    assert status == monitor.LOST and "run demo was last seen at 2" in printed.err
    assert "roles alive 1" in printed.out


def test_a_run_is_followed_to_a_hub_elsewhere(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(view, "QUIET_AFTER_S", 0.5)
    monkeypatch.setattr(watching, "LOOK_EVERY_S", 0.1)
    folder = make_run(tmp_path / "demo")
    with ZenohHub("tcp/127.0.0.1:17980") as first, ZenohHub("tcp/127.0.0.1:17985") as second:
        (folder / "endpoint").write_text(first.endpoint)
        transport = ZenohTransport(second.endpoint)

        def move():
            (folder / "endpoint").write_text(second.endpoint)
            fields = {"time_s": 1.0, "role": "scheduler", "id": "0", "stage": "done", "episodes": 11}
            while not over.wait(0.2):
                transport.publish(keys.stats("demo", "scheduler", "0"), json.dumps(fields).encode(), json=True)

        over, moves = threading.Event(), threading.Timer(0.5, move)
        moves.start()
        summary = threading.Timer(3.0, lambda: (folder / "summary.json").write_text(json.dumps(ENDED)))
        summary.start()
        status, printed = run(capsys, "--runs", tmp_path)
        over.set()
        moves.join()
        summary.join()
        transport.close()
    assert status == 0 and "run demo ended at" in printed.out


def test_a_run_in_one_process_is_refused_with_the_reason(capsys, tmp_path):
    make_run(tmp_path / "demo", "placement=inline", "transport.kind=memory")
    status, printed = run(capsys, "--runs", tmp_path)
    assert status == cli.REFUSED and "one process" in printed.err and "metrics.jsonl" in printed.err


def test_the_next_run_is_waited_for_where_none_is_alive(capsys, tmp_path, hub):
    make_run(tmp_path / "old", summary=ENDED)
    transport = ZenohTransport(hub.endpoint)

    def live():
        folder = make_run(tmp_path / "demo")
        with locks.held(folder, "the run"):
            (folder / "endpoint").write_text(hub.endpoint)
            fields = {"time_s": 1.0, "role": "scheduler", "id": "0", "stage": "done", "episodes": 11}
            while not over.wait(0.2):
                transport.publish(keys.stats("demo", "scheduler", "0"), json.dumps(fields).encode(), json=True)

    over, starts = threading.Event(), threading.Timer(0.7, live)
    starts.start()
    summary = threading.Timer(2.5, lambda: (tmp_path / "demo" / "summary.json").write_text(json.dumps(ENDED)))
    summary.start()
    status, printed = run(capsys, "--runs", tmp_path, "--wait")
    over.set()
    starts.join()
    summary.join()
    transport.close()
    assert status == 0 and "old" not in printed.out and "run demo ended at" in printed.out
    assert "no run is alive" in printed.out.splitlines()[0]


@pytest.mark.parametrize("other", [["--once"], ["--run", "x"], ["--connect", "tcp/127.0.0.1:1"]])
def test_an_option_that_names_a_run_is_refused_beside_waiting_for_the_next(capsys, other):
    status, printed = run(capsys, "--wait", *other)
    assert status == cli.REFUSED and f"{other[0]} cannot be combined with --wait" in printed.err


def test_a_run_that_was_killed_a_moment_ago_is_told_by_its_lock_in_one_process_too(capsys, tmp_path):
    folder = make_run(tmp_path / "demo", "placement=inline", "transport.kind=memory")
    (folder / locks.LOCK_FILE).touch()
    status, printed = run(capsys, "--runs", str(tmp_path), "--once")
    assert status == monitor.LOST and "demo was last seen at" in printed.err and "it was killed" in printed.err


def test_a_run_is_chosen_by_its_name(capsys, tmp_path):
    make_run(tmp_path / "first", summary=ENDED)
    make_run(tmp_path / "second", summary=ENDED)
    for name in ("first", "second"):
        assert f"run {name} ended" in run(capsys, "--runs", tmp_path, "--run", name)[1].out
    status, printed = run(capsys, "--runs", tmp_path, "--run", "third")
    assert status == cli.REFUSED and "'third'" in printed.err and "first" in printed.err
