"""Runner of each role in a Ray actor of its own, on this machine or on a cluster. No other file imports Ray."""

import json
import logging
import os
import re
import secrets
import time
from collections.abc import Callable, Sequence
from typing import Any

import ray
from ray.exceptions import GetTimeoutError, RayActorError, RayError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from zsdist.common import signals
from zsdist.common.allowed_resources import allowed_cores
from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.roles.base import HEARTBEAT_S, HOST
from zsdist.roles.replay import shards
from zsdist.run import cluster_address, local_ray, program, ray_lean
from zsdist.run.directory import issue_epochs
from zsdist.run.guests import Guests
from zsdist.run.heartbeats import HUB, Heartbeats
from zsdist.run.last_words import RoleLog
from zsdist.run.presence import Presence
from zsdist.run.processes import ProcessIdentity
from zsdist.run.program import RoleSpec, RunSpec, Watch
from zsdist.run.restarts import Restarts, StandbyPace
from zsdist.run.role_host import RoleHost
from zsdist.transport.base import Mailbox, Transport
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders

OBJECT_STORE_BYTES = 256 * 2**20  # it carries settings and checkpoints at the start, and nothing afterwards
START_WITHIN_S = 120.0  # longest wait for the process of the hub
FIRST_WITHIN_S = 30.0  # on a cluster, for those that live on this machine, before others may take their room
LEAVE_WITHIN_S = 5.0  # time for the roles to end by themselves once the run is over
STANDBY_AFTER_S = 1.0  # delay of the standby's start, which loads a core for seconds, after other starts
STARTS_TRIED = 3  # of Ray on this machine, whose own limit of 30 s a busy machine may exceed
WORDS_BYTES = 2**22  # statistics that wait for the supervisor
WAITS = "its process has not started yet; it waits for free cores of Ray, or for a machine that starts processes"


def run(
    spec: RunSpec,
    epochs: Sequence[int],
    *,
    interrupted: Callable[[], bool] = lambda: False,
    watch: Watch = lambda transport, now: None,
) -> None:
    """Run to the end, or until an interruption is noticed and everything is saved.

    A role that dies or stops is replaced by a new incarnation, which goes on from what its predecessor has written:
    a replay from its journal, the scheduler from its ledger, a learner from its kept state. A new hub listens at the
    endpoint of its predecessor.

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
    for tries_left in reversed(range(STARTS_TRIED)):
        try:
            # Where Ray starts no process, a signal may end a long wait.
            with signals.kept() if address is not None else signals.withheld(), ray_lean.lean():
                _init(config)
            break
        except Exception as error:  # Ray raises errors of a dozen classes, also built-in ones
            ray.shutdown()
            slow = address is None and "timed out" in str(error)
            if slow and tries_left:
                continue
            busy = f"this machine was too busy {STARTS_TRIED} times; try again later, or use --single-process: "
            raise RunError(f"{what}: {busy if slow else ''}{_summary(error)}") from error
    if address is not None and (wanted := _cores(config)) > (free := ray.cluster_resources().get("CPU", 0.0)):
        ray.shutdown()
        raise RunError(
            f"the run asks for {wanted:g} cores of Ray, the cluster has {free:g}; lower run.cpus_per_role or run.actors"
        )
    if address is not None and (wanted := cores_here(config)) > (free := _cores_of_this_node()):
        ray.shutdown()
        raise RunError(
            f"the roles that live on this machine ask for {wanted:g} cores of Ray, it has {free:g} of them; lower "
            "run.cpus_per_role, or give it more (ray start --num-cpus)"
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


def cores_here(config: Config) -> float:
    """Return how many of Ray's cores those processes ask for that must live on this machine."""
    staying = [role_spec for role_spec in _all_roles(config) if stays_here(role_spec, config)]
    return config.run.cpus_per_role * (len(staying) + config.run.standby)


def _all_roles(config: Config) -> list[RoleSpec]:
    return [RoleSpec("hub", "0", 0), *program.roles(config, range(program.role_count(config)))]


def _cores_of_this_node() -> float:
    here = ray.get_runtime_context().get_node_id()
    return float(sum(node["Resources"].get("CPU", 0.0) for node in ray.nodes() if node["NodeID"] == here))


def _summary(error: Exception) -> str:
    """Return one of Ray's errors as one line without its colours."""
    return " ".join(re.sub(r"\x1b\[[0-9;]*m", "", str(error)).split()) or type(error).__name__


class _Supervisor:
    """Supervisor that starts the roles, replaces those that die or stop, and reports to the scheduler."""

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
        self.logs: dict[str, RoleLog] = {}
        self.standby: ray.actor.ActorHandle | None = None
        self.pace = StandbyPace()
        self.places: dict[ray.actor.ActorHandle, ProcessIdentity | None] = {}  # None: it cannot be seen from here
        self.asked: dict[ray.ObjectRef, ray.actor.ActorHandle] = {}  # questions for places
        self.heartbeats = Heartbeats(time.monotonic())
        self.presence = Presence()
        self.words = Mailbox(WORDS_BYTES)
        self.guests: Guests  # from the connection to the hub on

    def run(self, interrupted: Callable[[], bool], watch: Watch) -> None:
        """Run until the scheduler has finished."""
        self.hosts[HUB] = self._host(self.role_specs[HUB])
        self.endpoint = self._ask(self.hosts[HUB].open_hub.remote(None), "hub")
        (self.spec.folder / "endpoint").write_text(self.endpoint, encoding="utf-8")
        self._drive(self.role_specs[HUB])
        transport = self.spec.connect(program.supervisor([self.epoch]), self.endpoint)
        transport.subscribe(keys.stats(self.spec.run, keys.ANY, keys.ANY), self.words)
        try:
            self.guests = Guests(self.spec, transport, lambda: issue_epochs(self.spec.folder, 1)[0])
            self._start()
            while "scheduler-0" in self.work.values():
                self._supervise(transport, interrupted())
                watch(transport, time.time())
            self._leave()
            watch(transport, time.time())
        finally:
            transport.close()
            for host in [*self.hosts.values(), *([self.standby] if self.standby else [])]:
                ray.kill(host)

    def _start(self) -> None:
        """Start all roles but the hub, first those that live on this machine: on a cluster others may fill it."""
        first = [role_spec for role_spec in self.role_specs.values() if stays_here(role_spec, self.spec.config)]
        then = [role_spec for role_spec in self.role_specs.values() if role_spec not in first]
        for role_spec in (*first, *then):
            if then and role_spec is then[0] and self.spec.config.run.address is not None:
                ray.wait(list(self.asked), num_returns=len(self.asked), timeout=FIRST_WITHIN_S)
            if role_spec.name != HUB:
                self.hosts[role_spec.name] = self._host(role_spec)
                self._drive(role_spec)

    def _supervise(self, transport: Transport, interrupted: bool) -> None:
        self.guests.step(time.time())
        for name in self.presence.update(self.role_specs.values(), self._is_there, time.monotonic()):
            self._report(transport, "role_waits", name, WAITS)
        content = program.supervision(
            self.presence.actors,
            restarts=self.restarts.by_kind(),
            interrupted=interrupted,
            guests=self.guests.epochs,
            left=self.guests.left | self.presence.left,
        )
        orders = codec.encode(Orders(self.epoch, "scheduler", content))
        transport.publish(keys.control(self.spec.run, "scheduler"), orders, retained=True)
        ended, _ = ray.wait(list(self.work), timeout=HEARTBEAT_S)
        for reference in ended:
            self._account_for(self.work.pop(reference), reference, transport)
        self._listen()
        for name in self.heartbeats.silent(time.monotonic()):
            self._examine(name, transport)
        self._keep_standby(time.monotonic())

    def _account_for(self, name: str, reference: ray.ObjectRef, transport: Transport) -> None:
        """Handle the end of a role: it has finished, failed with a reason, or died with its process."""
        try:
            if reason := ray.get(reference):
                raise RunError(reason)
            self.heartbeats.forget(name)
        except RayActorError as error:  # its process is gone
            self._replace(name, _last_line(error), transport)
        except RayError as error:  # a defect, which a restart would only repeat
            raise RunError(self.logs[name].named_in(f"{_last_line(error)}; {name} failed")) from None

    def _listen(self) -> None:
        """Note which roles have published statistics, and in which processes of this machine hosts live."""
        now = time.monotonic()
        for message in self.words.drain():
            key = keys.parse(message.key)
            name = f"{key.fields['role']}-{key.fields['id']}" if key else ""
            if name in self.role_specs and self.heartbeats.hear(name, _epoch_in(message.payload), now):
                self.restarts.note_sign(name)
        for reference in ray.wait(list(self.asked), num_returns=len(self.asked), timeout=0)[0] if self.asked else []:
            host = self.asked.pop(reference)
            try:
                machine, process = ray.get(reference)
            except RayError:
                continue  # `_account_for` or `_keep_standby` deals with its death
            self.places[host] = process if machine == HOST and process.started else None
            for name in (name for name, other in self.hosts.items() if other == host):
                self.heartbeats.note_process(name, now)

    def _examine(self, name: str, transport: Transport) -> None:
        """Replace a silent role that has stopped: kill it first, so that it never works beside its successor."""
        if not self._is_there(name):
            return  # its process waits until a machine has room for it
        host, now = self.hosts[name], time.monotonic()
        place = self.places.get(host)
        reason = self.heartbeats.verdict(name, None if place is None else place.pulse(), now)
        if reason is None:
            return
        ray.kill(host)
        if place is not None and not place.kill():
            reason += ", and it cannot be killed yet"
        self.work = {reference: other for reference, other in self.work.items() if other != name}
        self._replace(name, reason, transport)

    def _replace(self, name: str, reason: str, transport: Transport) -> None:
        log = self.logs[name]
        words = "; ".join(filter(None, (log.last_words(), f"{name} died: {reason}")))
        if not self.restarts.may_replace(name):
            raise RunError(log.named_in(words))
        try:
            role_spec = self.restarts.replace(name, words, time.monotonic())
        except RunError as error:
            raise RunError(log.named_in(str(error))) from None
        self.places.pop(self.hosts[name], None)
        self.hosts[name] = self._stand_in(role_spec)
        self._drive(role_spec)
        self._report(transport, "role_replaced", name, reason)

    def _report(self, transport: Transport, event: str, name: str, reason: str) -> None:
        about = {"time_s": round(time.time(), 3), "role": "supervisor", "id": "0", "host": HOST, "pid": os.getpid()}
        content = {**about, "event": event, "name": name, "reason": reason[:200]}
        transport.publish(keys.events(self.spec.run), json.dumps(content).encode(), json=True)

    def _is_there(self, name: str) -> bool:
        """Return whether the process of a role has answered."""
        return self.hosts.get(name) in self.places

    def _drive(self, role_spec: RoleSpec) -> None:
        name, now = role_spec.name, time.monotonic()
        self.logs[name] = RoleLog(self.spec.folder / "logs" / f"{name}.log")
        self.work[self.hosts[name].drive.remote(role_spec, self.endpoint)] = name
        self.restarts.note_start(name, now)
        self.heartbeats.expect(name, role_spec.epoch, now)
        self.pace.delay(now + STANDBY_AFTER_S)

    def _stand_in(self, role_spec: RoleSpec) -> "ray.actor.ActorHandle":
        """Return the standby process; a new one where there is none or the role may live on another machine."""
        config, host = self.spec.config, self.standby
        here = stays_here(role_spec, config) or role_spec.role == "learner" or config.run.address is None
        if host is None or not here or not self._stands(host):
            return self._host(role_spec, here=here)
        self.standby = None
        self.pace.note_use()
        return host

    def _keep_standby(self, now: float) -> None:
        """Start a standby process where one is due, and give up one that has died or was stopped."""
        if self.standby is not None and not self._stands(self.standby):
            ray.kill(self.standby)
            if (place := self.places.pop(self.standby, None)) is not None:
                place.kill()
            self.standby = None
            self.pace.note_death(now)
        if self.standby is None and self.spec.config.run.standby and now > self.pace.due_s:
            self.standby = self._host(self.role_specs[HUB])
            self.standby.warm_up.remote()

    def _stands(self, standby: "ray.actor.ActorHandle") -> bool:
        """Return whether the standby process works, as far as is known."""
        if standby not in self.places:
            return standby in self.asked.values()
        place = self.places[standby]
        pulse = None if place is None else place.pulse()
        return place is None or (pulse is not None and not pulse.stopped)

    def _host(self, role_spec: RoleSpec, *, here: bool = False) -> "ray.actor.ActorHandle":
        options: dict[str, Any] = {
            "num_cpus": self.spec.config.run.cpus_per_role,
            "max_restarts": 0,
            "max_concurrency": 3,  # `drive`, and `stop` or `place` meanwhile
        }
        if here or stays_here(role_spec, self.spec.config):
            node = ray.get_runtime_context().get_node_id()
            options["scheduling_strategy"] = NodeAffinitySchedulingStrategy(node, soft=False)
        host_class: Any = ray.remote(**options)(RoleHost)  # Ray's types cover classes only without options
        host = host_class.remote(self.spec)
        self.asked[host.place.remote()] = host
        return host

    def _leave(self) -> None:
        """Wait a while for the other roles to end by themselves."""
        others = [reference for reference, name in self.work.items() if name != HUB and self._is_there(name)]
        if others:
            ray.wait(others, num_returns=len(others), timeout=LEAVE_WITHIN_S)
        ray.wait([self.hosts[HUB].stop.remote()], timeout=LEAVE_WITHIN_S)

    def _ask(self, reference: ray.ObjectRef, name: str) -> str:
        try:
            return ray.get(reference, timeout=START_WITHIN_S)
        except GetTimeoutError:
            about = f"Ray has not started its process within {START_WITHIN_S:.0f} s"
            raise RunError(f"{name} could not start: {about}; see whether Ray has free cores on this machine") from None
        except RayError as error:
            raise RunError(f"{name} could not start: {_last_line(error)}") from error


def _epoch_in(payload: bytes) -> int:
    """Return the epoch of the sender of statistics; -1 where they name none."""
    try:
        epoch = json.loads(payload)["epoch"]
    except (ValueError, RecursionError, KeyError, TypeError):
        return -1
    return epoch if isinstance(epoch, int) else -1


def stays_here(role_spec: RoleSpec, config: Config) -> bool:
    """Return whether a role must live on this machine: it needs its address, its files, or its certificate."""
    guarded = config.transport.tls is not None and role_spec.role != "actor"
    return guarded or role_spec.role in ("hub", "scheduler", shards.ROLE)


def _last_line(error: Exception) -> str:
    """Return the last line of one of Ray's long reports, which names the cause."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1].partition(" Worker exit type:")[0] if lines else type(error).__name__
