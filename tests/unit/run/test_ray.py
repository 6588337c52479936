"""Decisions of the Ray runner that need no cluster; whole runs are in tests/integration/test_launch.py."""

import threading

import pytest

from zsdist.config import parse
from zsdist.errors import RunError
from zsdist.run.program import RoleSpec
from zsdist.run.ray import RoleHost, stays_here
from zsdist.transport.memory import MemoryBroker, MemoryTransport

ROLES = ("hub", "scheduler", "replay", "learner", "actor")
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
        self.folder, self.role, self.closed = folder, role, threading.Event()

    def connect(self, role_spec, endpoint):
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


def test_roles_with_files_or_the_endpoint_stay_on_the_first_machine():
    assert {role for role in ROLES if stays_here(RoleSpec(role, "0", 1), parse({}))} == {"hub", "scheduler", "replay"}


def test_with_certificates_only_actors_live_on_other_machines(tmp_path):
    config = parse({"transport": {"tls": str(tmp_path)}})
    assert {role for role in ROLES if not stays_here(RoleSpec(role, "0", 1), config)} == {"actor"}
