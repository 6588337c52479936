"""Runner of each role in a Ray actor of its own, on this machine or on a cluster. No other file imports Ray."""

import logging
import os
import re
import secrets
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import ray
from ray.exceptions import RayActorError, RayError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from zsdist.common import output_files, signals
from zsdist.common.allowed_resources import allowed_cores
from zsdist.config import Config
from zsdist.errors import RunError, ZsdistError
from zsdist.roles.base import HEARTBEAT_S, Role
from zsdist.roles.replay import shards
from zsdist.run import cluster_address, local_ray, preflight, program
from zsdist.run.allocator import keep_freed_memory
from zsdist.run.directory import issue_epochs
from zsdist.run.guests import Guests
from zsdist.run.program import ActorParts, RoleSpec, RunSpec, Watch
from zsdist.run.restarts import Restarts
from zsdist.transport.base import Transport
from zsdist.transport.zenoh import ZenohHub
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders

OBJECT_STORE_BYTES = 256 * 2**20  # it carries settings and checkpoints at the start, and nothing afterwards
LEAVE_WITHIN_S = 5.0  # time for the roles to end by themselves once the run is over
STANDBY_AFTER_S = 1.0  # delay of the standby's start, which loads a core for seconds, after other starts
HUB = "hub-0"


class RoleHost:
    """Content of a Ray actor, which builds one role and steps it until it has finished."""

    def __init__(self, spec: RunSpec) -> None:
        keep_freed_memory()
        self.spec = spec
        self.wake = threading.Event()
        self._stop = False
        self._hub: ZenohHub | None = None
        self._parts: ActorParts | None = None

    def warm_up(self) -> None:
        """Make and use the parts of an actor, which take longest, so that any role can start here at once later."""
        parts = self.spec.make_parts(self.spec.config)
        preflight.try_out(parts, self.spec.config)
        self._parts = parts

    def open_hub(self, endpoint: str | None) -> str:
        """Open the router in this process and return the endpoint at which it listens.

        Args:
            endpoint: endpoint of the hub's predecessor; None: this is the run's first hub.
        """
        self._hub = self.spec.open_hub(endpoint)
        return self._hub.endpoint

    def drive(self, role_spec: RoleSpec, endpoint: str) -> str:
        """Build a role and step it to its end; return an empty string, or the reason of its failure in one line."""
        transport = None
        if role_spec.role == "learner":
            import torch

            torch.set_num_threads(1)
        try:
            self._redirect_output(role_spec)
            if role_spec.name == HUB and self._hub is None:
                self.open_hub(endpoint)
            transport = self.spec.connect(role_spec, endpoint)
            if self._hub is None:
                role = self.spec.build(role_spec, transport, self.wake, self._parts)
            else:
                role = program.make_hub(self.spec, role_spec, transport, self.wake, endpoint)
            self._step(role)
        except ZsdistError as error:
            return role_spec.reason(error)
        except OSError as error:
            if error.errno in output_files.OF_THE_SYSTEM:
                return role_spec.reason(error)
            traceback.print_exc()
            raise
        except Exception:
            traceback.print_exc()  # into the role's log; the supervisor ends the run
            raise
        finally:
            if transport is not None:
                transport.close()
            if self._hub is not None:
                self._hub.close()
        return ""

    def stop(self) -> None:
        """Make `drive` return after the current step; called from another thread of the Ray actor."""
        self._stop = True
        self.wake.set()

    def _step(self, role: Role) -> None:
        offset_s = time.time() - time.monotonic()  # unix time that never runs backwards
        while not self._stop:
            due_s = role.step(offset_s + time.monotonic())
            if due_s is None:
                return
            self.wake.wait(max(0.0, due_s - offset_s - time.monotonic()))
            self.wake.clear()

    def _redirect_output(self, role_spec: RoleSpec) -> None:
        """Redirect output to `logs/{role}.log` of the run directory, where that is on this machine."""
        logs = self.spec.folder / "logs"
        if not logs.is_dir():
            return
        log = os.open(logs / f"{role_spec.name}.log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
            os.dup2(log, stream.fileno())
        os.close(log)


def run(
    spec: RunSpec,
    epochs: Sequence[int],
    *,
    interrupted: Callable[[], bool] = lambda: False,
    watch: Watch = lambda transport, now: None,
) -> None:
    """Run to the end, or until an interruption is noticed and everything is saved.

    A dead actor is replaced by a new incarnation. So is a dead replay, which resumes from its journal, a dead
    scheduler, which resumes from its ledger, and a dead hub, which listens at the endpoint of its predecessor. The
    death of any other role ends the run.

    Args:
        spec: specification of the run.
        epochs: new epochs, as many as `program.epoch_count` returns.
        interrupted: tells whether to stop early; called several times a second.
        watch: called several times a second with a transport to subscribe on and the clock.

    Raises:
        RunError: the cluster cannot be reached or is too small, or a role failed.
    """
    connect(spec.config)
    try:
        _Supervisor(spec, epochs).run(interrupted, watch)
    finally:
        ray.shutdown()


def connect(config: Config) -> None:
    """Start Ray on this machine, or connect to the cluster of the configuration; `ray.shutdown` ends both.

    Ray's processes do not react to signals that ask this one to stop, and its handlers do not stay in this one.

    Raises:
        RunError: the cluster cannot be reached or is too small, or Ray cannot be started here.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # else roles that reserve no GPU cannot see one
    address = config.run.address
    what = "Ray cannot be started here" if address is None else f"Ray cluster {address!r} cannot be used"
    try:
        # Where Ray starts no process, a signal may end a long wait.
        with signals.kept() if address is not None else signals.withheld():
            _init(config)
    except Exception as error:  # Ray raises errors of a dozen classes, also built-in ones
        ray.shutdown()
        raise RunError(f"{what}: {_summary(error)}") from error
    if address is not None and (wanted := _cores(config)) > (free := ray.cluster_resources().get("CPU", 0.0)):
        ray.shutdown()
        raise RunError(
            f"the run asks for {wanted:g} cores of Ray, the cluster has {free:g}; lower run.cpus_per_role or run.actors"
        )


def try_start() -> None:
    """Start Ray on this machine and end it at once; raise `RunError` where it cannot be started."""
    connect(Config())
    ray.shutdown()


def _init(config: Config) -> None:
    if config.run.address is not None:
        ray.init(address=cluster_address.named(config.run.address), log_to_driver=False, logging_level=logging.ERROR)
        return
    if not {"RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"} & os.environ.keys():
        # Ray's processes inherit it. Otherwise Ray writes one into the home folder, which may not be writable.
        os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)
    ray.init(
        address="local",  # a cluster of its own, also where RAY_ADDRESS names another
        num_cpus=local_ray.logical_cores(config, allowed_cores()),
        object_store_memory=OBJECT_STORE_BYTES,
        include_dashboard=False,
        log_to_driver=False,
        logging_level=logging.ERROR,
        _node_ip_address="127.0.0.1",  # one machine: no other one needs to reach it
    )


def _cores(config: Config) -> float:
    """Return the number of Ray's cores that a run asks for."""
    return config.run.cpus_per_role * (program.role_count(config) + 1 + config.run.standby)


def _summary(error: Exception) -> str:
    """Return one of Ray's errors as one line without its colours."""
    return " ".join(re.sub(r"\x1b\[[0-9;]*m", "", str(error)).split()) or type(error).__name__


class _Supervisor:
    """Supervisor that starts the roles, replaces dead ones where it may, and reports both to the scheduler."""

    def __init__(self, spec: RunSpec, epochs: Sequence[int]) -> None:
        self.spec = spec
        self.epoch, hub_epoch, *role_epochs = epochs
        self.restarts = Restarts(
            [RoleSpec("hub", "0", hub_epoch), *program.roles(spec.config, role_epochs)],
            lambda: issue_epochs(spec.folder, 1)[0],
        )
        self.role_specs = self.restarts.role_specs
        self.hosts: dict[str, ray.actor.ActorHandle] = {}
        self.work: dict[ray.ObjectRef, str] = {}  # result of each role's `drive` -> its name
        self.standby: ray.actor.ActorHandle | None = None
        self.standby_due_s = 0.0
        self.guests: Guests  # from the connection to the hub on

    def run(self, interrupted: Callable[[], bool], watch: Watch) -> None:
        """Run until the scheduler has finished."""
        self.hosts[HUB] = self._host(self.role_specs[HUB])
        self.endpoint = self._ask(self.hosts[HUB].open_hub.remote(None), "hub")
        (self.spec.folder / "endpoint").write_text(self.endpoint, encoding="utf-8")
        self._drive(self.role_specs[HUB])
        transport = self.spec.connect(program.supervisor([self.epoch]), self.endpoint)
        try:
            self.guests = Guests(self.spec, transport, lambda: issue_epochs(self.spec.folder, 1)[0])
            for name, role_spec in self.role_specs.items():
                if name != HUB:
                    self.hosts[name] = self._host(role_spec)
                    self._drive(role_spec)
            while "scheduler-0" in self.work.values():
                self._supervise(transport, interrupted())
                watch(transport, time.time())
            self._leave()
            watch(transport, time.time())
        finally:
            transport.close()
            for host in [*self.hosts.values(), *([self.standby] if self.standby else [])]:
                ray.kill(host)

    def _supervise(self, transport: Transport, interrupted: bool) -> None:
        self.guests.step(time.time())
        content = program.supervision(
            list(self.role_specs.values()),
            restarts=self.restarts.by_kind(),
            interrupted=interrupted,
            guests=self.guests.epochs,
            left=self.guests.left,
        )
        orders = codec.encode(Orders(self.epoch, "scheduler", content))
        transport.publish(keys.control(self.spec.run, "scheduler"), orders, retained=True)
        ended, _ = ray.wait(list(self.work), timeout=HEARTBEAT_S)
        for reference in ended:
            self._account_for(self.work.pop(reference), reference)
        if self.standby is None and self.spec.config.run.standby and time.monotonic() > self.standby_due_s:
            self.standby = self._host(self.role_specs[HUB])
            self.standby.warm_up.remote()

    def _account_for(self, name: str, reference: ray.ObjectRef) -> None:
        """Handle the end of a role: it has finished, failed with a reason, or died with its process."""
        try:
            if reason := ray.get(reference):
                raise RunError(reason)
            return
        except RayActorError as error:  # its process is gone
            reason = f"{name} died: {_last_line(error)}"
            if self.restarts.may_replace(name):
                self._replace(name, reason)
                return
        except RayError as error:  # a defect, which a restart would only repeat
            reason = f"{name} failed: {_last_line(error)}"
        log = self.spec.folder / "logs" / f"{name}.log"
        raise RunError(f"{reason}; its log is {log}" if log.exists() else reason)

    def _replace(self, name: str, reason: str) -> None:
        role_spec = self.restarts.replace(name, reason)
        self.hosts[name] = self._stand_in(role_spec)
        self._drive(role_spec)

    def _drive(self, role_spec: RoleSpec) -> None:
        self.work[self.hosts[role_spec.name].drive.remote(role_spec, self.endpoint)] = role_spec.name
        self.standby_due_s = time.monotonic() + STANDBY_AFTER_S

    def _stand_in(self, role_spec: RoleSpec) -> "ray.actor.ActorHandle":
        """Return the standby process; a new one where there is none or the role may live on another machine."""
        config = self.spec.config
        if self.standby is None or not (stays_here(role_spec, config) or config.run.address is None):
            return self._host(role_spec)
        host, self.standby = self.standby, None
        return host

    def _host(self, role_spec: RoleSpec) -> "ray.actor.ActorHandle":
        options: dict[str, Any] = {
            "num_cpus": self.spec.config.run.cpus_per_role,
            "max_restarts": 0,
            "max_concurrency": 2,
        }
        if stays_here(role_spec, self.spec.config):
            here = ray.get_runtime_context().get_node_id()
            options["scheduling_strategy"] = NodeAffinitySchedulingStrategy(here, soft=False)
        host_class: Any = ray.remote(**options)(RoleHost)  # Ray's types cover classes only without options
        return host_class.remote(self.spec)

    def _leave(self) -> None:
        """Wait a while for the other roles to end by themselves."""
        others = [reference for reference, name in self.work.items() if name != HUB]
        if others:
            ray.wait(others, num_returns=len(others), timeout=LEAVE_WITHIN_S)
        ray.wait([self.hosts[HUB].stop.remote()], timeout=LEAVE_WITHIN_S)

    def _ask(self, reference: ray.ObjectRef, name: str) -> str:
        try:
            return ray.get(reference)
        except RayError as error:
            raise RunError(f"{name} could not start: {_last_line(error)}") from error


def stays_here(role_spec: RoleSpec, config: Config) -> bool:
    """Return whether a role must live on this machine: it needs its address, its files, or its certificate."""
    guarded = config.transport.tls is not None and role_spec.role != "actor"
    return guarded or role_spec.role in ("hub", "scheduler", shards.ROLE)


def _last_line(error: Exception) -> str:
    """Return the last line of one of Ray's long reports, which names the cause."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1].partition(" Worker exit type:")[0] if lines else type(error).__name__
