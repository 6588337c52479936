"""Runs on a Ray cluster of several nodes, which are processes of this machine, with its token and with certificates."""

import json
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from ray_machines import CHAOS, environment, machines
from sockets import free_endpoint

from zsdist.diagnostics.cluster import check_address
from zsdist.diagnostics.result import CheckStatus
from zsdist.roles import permissions
from zsdist.transport import certificates
from zsdist.transport.base import Mailbox
from zsdist.transport.certificates import Identity
from zsdist.transport.zenoh import ZenohTransport

pytestmark = [pytest.mark.integration, pytest.mark.slow]

TOKEN = secrets.token_hex(32)
CORE = {"object_store_memory": 80 * 2**20}
NODES = {  # the learners and the replay have a node of their own; one of the last two is empty at first
    "head": {"num_cpus": 2, **CORE},
    "school": {"num_cpus": 3, "labels": {"zsdist/place": "school"}, **CORE},
    "one": {"num_cpus": 1, **CORE},
    "two": {"num_cpus": 1, **CORE},
}
AT_SCHOOL = ("node=others", "labels=zsdist/place=school")
PATIENCE_S = 100.0


def address_of_this_machine():
    """Return the address at which others reach this machine; None: it has none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing
        except OSError:
            return None
        found = probe.getsockname()[0]
    return None if found.startswith("127.") else found


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Cluster, its certificates, and its address on the network."""
    if (address := address_of_this_machine()) is None:
        pytest.skip("a run on a cluster needs an address other than loopback, and this machine has none")
    tls = tmp_path_factory.mktemp("cluster") / "tls"
    certificates.make(tls, permissions.HUB, permissions.client_names(1), [address], 1)
    short = Path(tempfile.mkdtemp(dir="/tmp"))  # paths of Ray's sockets have to fit in
    with machines(short, TOKEN, NODES) as found:
        if found is None:
            pytest.skip(f"Ray's cluster cannot start here: {(short / 'machines.log').read_text()[-300:]}")
        yield found, tls, address, short
    shutil.rmtree(short, ignore_errors=True)


class Run:
    """Run that is being launched on the cluster by `tests/chaos/launcher.py`."""

    def __init__(self, root, cluster, *settings):
        found, tls, address, folder = cluster
        self.folder, self.endpoint = root / "run", free_endpoint("tls").replace("127.0.0.1", address)
        root.mkdir(parents=True)
        fixed = (
            f"run.address={found.address}",
            f"transport.tls={tls}",
            f"transport.endpoint={self.endpoint}",
            "run.cpus_per_role=1",
            "run.standby=false",
        )
        known = environment(folder, TOKEN)
        command = [sys.executable, str(CHAOS / "launcher.py"), str(self.folder), *fixed, *settings]
        self.process = subprocess.Popen(
            command, env=known, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
        )
        self.identity, self.heard, self.transport = Identity.load(tls, permissions.TRUSTED), {}, None
        self.box, self.events = Mailbox(2**24), []

    def end(self):
        """Return the exit status and the last line of the output."""
        output, _ = self.process.communicate(timeout=PATIENCE_S)
        return self.process.returncode, output.strip().splitlines()[-1]

    def until(self, condition, what):
        """Wait until what is heard of the run meets a condition."""
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, f"waited {PATIENCE_S} s for {what}: {self.heard}"
            assert self.process.poll() is None, f"the run ended before {what}: {self.process.communicate()[0]}"
            if self.transport is None and (self.folder / "endpoint").exists():
                self.transport = ZenohTransport((self.folder / "endpoint").read_text(), self.identity)
                self.transport.subscribe("zsdist/*/stats/**", self.box)
                self.transport.subscribe("zsdist/*/events", self.box)
            for message in self.box.drain():
                fields = json.loads(message.payload)
                self.events.append(fields) if "event" in fields else None
                self.heard[f"{fields['role']}-{fields['id']}"] = fields
            time.sleep(0.05)

    def host(self, name):
        """Return the node of a role; None: it has not been heard yet."""
        return self.heard.get(name, {}).get("host")

    def close(self):
        if self.transport is not None:
            self.transport.close()
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()


@pytest.fixture
def launch(cluster, tmp_path):
    started = []

    def launch(*settings):
        started.append(Run(tmp_path / str(len(started)), cluster, *settings))
        return started[-1]

    yield launch
    for run in started:
        run.close()


@pytest.mark.parametrize(
    ("token", "words"), [(None, "there is none in RAY_AUTH_TOKEN, "), ("f" * 64, "refuses the token in RAY_AUTH_TOKEN")]
)
def test_a_launch_without_the_token_or_with_another_one_is_refused_in_one_line(cluster, tmp_path, token, words):
    found, tls, address, folder = cluster
    known = environment(folder, token or "") | {"HOME": str(tmp_path)}
    if token is None:
        known = {name: value for name, value in known.items() if not name.startswith("RAY_AUTH")}
    settings = (f"transport.tls={tls}", f"transport.endpoint={free_endpoint('tls').replace('127.0.0.1', address)}")
    command = [sys.executable, "-m", "zsdist.launch", "--address", found.address, "--run-dir", str(tmp_path / "run")]
    command += ["--actors", "1", *(word for setting in settings for word in ("--set", setting))]
    ended = subprocess.run(command, env=known, capture_output=True, text=True, timeout=PATIENCE_S)
    assert ended.returncode == 2 and ended.stdout == "" and not (tmp_path / "run").exists()
    line = ended.stderr.splitlines()[-1]  # before it Matplotlib may say that it looks for fonts
    assert line.startswith("zsdist.launch: error: Ray cluster") and words in line and found.address in line


def test_the_doctor_connects_with_the_token_and_shows_the_nodes(cluster, monkeypatch):
    for name, value in environment(cluster[3], TOKEN).items():
        monkeypatch.setenv(name, value)
    result = check_address(cluster[0].address)
    assert result.status is CheckStatus.OK, result.found
    assert "4 nodes: " in result.found and "school: 3 cores of Ray" in result.found


@pytest.mark.timeout(300)
def test_a_head_that_is_too_small_is_refused_before_anything_starts(launch):
    run = launch()
    status, line = run.end()
    assert status == 2 and not run.folder.exists()
    assert "the roles that live on this machine ask for 5 cores of Ray" in line and "head has 2 cores of Ray" in line
    assert "cluster.learner.node=others" in line


@pytest.mark.timeout(300)
def test_roles_live_where_they_were_asked_to_and_a_lost_node_takes_only_its_actors(launch, cluster, tmp_path):
    placed = [f"cluster.{role}.{setting}" for role in ("learner", "replay") for setting in AT_SCHOOL]
    placed.append("cluster.actor.node=others")
    run = launch(*placed, f"replay.journals={tmp_path / 'disk'}", "run.episodes=120", "run.actors=1")
    run.until(lambda: run.heard.get("actor-0", {}).get("env_steps", 0) > 0, "the actor drives")
    run.until(lambda: run.host("learner-low") and run.host("learner-high"), "the learners learn")
    assert {run.host(name) for name in ("learner-low", "learner-high", "replay-0")} == {"school"}
    assert run.host("scheduler-0") == run.host("hub-0") == socket.gethostname()
    assert list((tmp_path / "disk").iterdir())

    before = {name: fields["pid"] for name, fields in run.heard.items()}
    lost = run.host("actor-0")
    assert lost in ("one", "two")
    cluster[0].kill(lost)
    run.until(lambda: run.host("actor-0") not in (None, lost), "the actor is back")
    assert {run.host("actor-0"), lost} == {"one", "two"}
    status, line = run.end()
    assert (status, line) == (0, "ended: complete")
    summary = json.loads((run.folder / "summary.json").read_text())
    assert summary["restarts"] == {"actor": 1} and summary["learner_updates"]["low"] > 0
    stayed = set(before) - {"actor-0"}
    assert {name: run.heard[name]["pid"] for name in stayed} == {name: before[name] for name in stayed}
    for counts in summary["transitions"].values():
        assert counts["produced"] == counts["stored"] + counts["rejected"] > 0
    assert not list((tmp_path / "disk").iterdir())
