"""Decisions of the Ray runner that need no cluster; whole runs are in tests/integration/test_launch.py."""

import os
import re
import signal
import threading
from types import SimpleNamespace

import pytest
import ray
from fakes import FakeVisualAct
from ray.exceptions import RaySystemError
from rehearsal import kinematic

from zsdist.common import code_hash, signals
from zsdist.config import parse
from zsdist.errors import RunError
from zsdist.run import program, ray_cluster
from zsdist.run.program import RoleSpec, RunSpec
from zsdist.run.ray_cluster import connect
from zsdist.run.role_host import RoleHost
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.vision.fingerprint import VisionIdentity

SPEC = RoleSpec("actor", "0", 7)


class CountingRole:
    """Role that finishes after some steps, or fails in the first one."""

    def __init__(self, steps, error=None):
        self.left, self.error, self.steps = steps, error, 0

    def step(self, now):
        if self.error is not None:
            raise self.error
        self.steps += 1
        return None if self.steps == self.left else now


class MadeUpSpec:
    """Specification of a run with one made-up role."""

    def __init__(self, folder, role):
        self.folder, self.role, self.closed, self.config = folder, role, threading.Event(), parse({})
        self.profile = False

    def connect(self, role_spec, endpoint, others=()):
        transport = MemoryTransport(MemoryBroker())
        transport.close = self.closed.set
        return transport

    def build(self, role_spec, transport, wake, parts):
        return self.role


def test_a_role_is_stepped_until_it_has_finished(tmp_path):
    spec = MadeUpSpec(tmp_path, CountingRole(3))
    assert RoleHost(spec).drive(SPEC, "tcp/nowhere") == ""
    assert spec.role.steps == 3 and spec.closed.is_set()


def test_a_role_that_fails_is_reported_by_name_in_one_line(tmp_path):
    spec = MadeUpSpec(tmp_path, CountingRole(3, RunError("the disk is full")))
    assert RoleHost(spec).drive(SPEC, "tcp/nowhere") == "actor-0: the disk is full"
    assert spec.closed.is_set()


def test_a_defect_is_raised_with_its_traceback_in_the_log(tmp_path, capsys):
    spec = MadeUpSpec(tmp_path, CountingRole(3, KeyError("x")))
    with pytest.raises(KeyError):
        RoleHost(spec).drive(SPEC, "tcp/nowhere")
    assert "Traceback" in capsys.readouterr().err and spec.closed.is_set()


def test_a_stopped_host_steps_no_more(tmp_path):
    spec = MadeUpSpec(tmp_path, CountingRole(10**9))
    host = RoleHost(spec)
    host.stop()
    assert host.drive(SPEC, "tcp/nowhere") == ""
    assert spec.role.steps == 0


CLUSTER = {"run": {"address": "head:6379"}, "transport": {"endpoint": "tls/10.0.0.1:7447", "tls": "certificates"}}


@pytest.mark.parametrize(
    "error",
    [
        RuntimeError("Version mismatch: the cluster was started with\n    \x1b[31mRay\x1b[0m: 2.60.0"),
        ConnectionError("Could not find any running Ray instance."),
        ValueError("the port is no number"),
        TimeoutError("timed out"),
        OSError("AF_UNIX path length cannot exceed 107 bytes"),
        RaySystemError("wrong token"),
        AssertionError(),
        Exception("The current node timed out during startup."),
    ],
)
@pytest.mark.parametrize(("settings", "what"), [({}, "cannot be started here"), (CLUSTER, "Ray cluster 'head:6379'")])
def test_whatever_ray_raises_at_its_start_is_one_line(monkeypatch, error, settings, what):
    def init(**options):
        raise error

    monkeypatch.setattr(ray, "init", init)
    with pytest.raises(RunError, match=what) as refused:
        connect(parse(settings))
    text = str(refused.value)
    assert "\n" not in text and "\x1b" not in text and not text.endswith(": ")


def test_ray_on_this_machine_has_a_token_of_its_own_and_so_writes_none_into_the_home_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("RAY_AUTH_TOKEN", "")
    monkeypatch.delenv("RAY_AUTH_TOKEN")
    monkeypatch.setenv("RAY_AUTH_TOKEN_PATH", str(tmp_path / "of-a-cluster"))  # Ray would prefer it, or write one
    seen = []
    monkeypatch.setattr(ray, "init", lambda **options: seen.append(os.environ["RAY_AUTH_TOKEN"]))
    connect(parse({}))
    connect(parse({}))
    assert len(set(seen)) == 1 and re.fullmatch("[0-9a-f]{64}", seen[0])


@pytest.mark.parametrize(("failures", "starts"), [(1, True), (2, True), (3, False)])
def test_a_start_of_ray_that_takes_too_long_is_tried_once_more(monkeypatch, failures, starts):
    def init(**options):
        tried.append(options)
        if len(tried) <= failures:
            raise Exception("The current node timed out during startup.")

    tried = []
    monkeypatch.setattr(ray, "init", init)
    if starts:
        connect(parse({}))
    else:
        with pytest.raises(RunError, match=r"this machine was too busy 3 times.*timed out during startup"):
            connect(parse({}))
    assert len(tried) == min(failures + 1, 3)


def test_the_handler_that_ray_sets_does_not_stay(monkeypatch):
    def init(**options):
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        masks.append(signal.pthread_sigmask(signal.SIG_BLOCK, []))

    masks = []
    monkeypatch.setattr(ray, "init", init)
    with signals.handled_by(signals.Interruption()) as interruption:
        connect(parse({}))
        signal.raise_signal(signal.SIGTERM)
        assert interruption.name == "SIGTERM"
    assert masks[0] >= set(signals.STOPPING)  # Ray's processes inherit this


@pytest.fixture
def cluster(monkeypatch):
    """Cluster of a head of 5 cores and another node, which a test may change; `ray.init` connects to it."""

    def shutdown():
        nodes.clear()

    nodes = {"head": {"CPU": 5.0}, "other": {"CPU": 95.0}}
    monkeypatch.setattr(ray, "init", lambda **options: None)
    monkeypatch.setattr(ray, "shutdown", shutdown)
    monkeypatch.setattr(ray, "get_runtime_context", lambda: SimpleNamespace(get_node_id=lambda: "head"))
    described = {"Alive": True, "Labels": {}}
    rows = lambda: [{**described, "NodeID": name, "NodeName": name, "Resources": nodes[name]} for name in nodes]  # noqa: E731
    monkeypatch.setattr(ray, "nodes", rows)
    monkeypatch.setattr(ray_cluster, "available_resources_per_node", lambda: nodes)
    return nodes


def test_a_machine_with_too_few_cores_for_the_roles_that_live_on_it_is_refused_and_left(cluster):
    config = parse({**CLUSTER, "run": {"address": "head:6379", "cpus_per_role": 1.0}})
    with pytest.raises(RunError, match=r"on this machine ask for 6 cores of Ray .*, head has 5 cores of Ray; lower"):
        connect(config)
    assert not cluster  # it is disconnected from


def test_a_standby_has_read_all_code_before_it_becomes_an_actor(tmp_path):
    settings = parse({})
    host = RoleHost(RunSpec(settings, "run", tmp_path, {}, VisionIdentity.of(FakeVisualAct(), "head"), kinematic))
    code_hash.sha256.cache_clear()
    host.warm_up()
    read = code_hash.sha256.cache_info().misses
    assert read == 1
    program.reading_fingerprint(settings, FakeVisualAct())
    assert code_hash.sha256.cache_info().misses == read


def test_a_cluster_that_fits_gives_every_needed_role_a_node(cluster):
    cluster["head"]["CPU"] = 6.0
    plan = connect(parse({**CLUSTER, "run": {"address": "head:6379", "cpus_per_role": 1.0}}))
    assert {node.id for node in plan.nodes.values()} == {plan.here} == {"head"} and len(plan.nodes) == 6
