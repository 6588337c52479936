import json
import os
import threading
import time
from contextlib import contextmanager

import pytest
from rehearsal import SEEN
from sockets import free_endpoint

from zsdist import config, monitor
from zsdist.common import cli
from zsdist.roles import permissions
from zsdist.run.program import RoleSpec, RunSpec
from zsdist.telemetry import watching
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
        (tmp_path / name).mkdir()
        (tmp_path / name / "endpoint").write_text(endpoint)
    now = time.time()
    os.utime(tmp_path / "old" / "endpoint", (now - 60, now - 60))
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
