"""Runner of each role in a Ray actor of its own, on this machine or on a cluster."""

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import ray
from ray.exceptions import GetTimeoutError, RayActorError, RayError

from zsdist.errors import RunError
from zsdist.roles.base import HEARTBEAT_S, HOST
from zsdist.run import checkpoint_states, program
from zsdist.run.directory import issue_epochs
from zsdist.run.guests import Guests
from zsdist.run.heartbeats import HUB, Heartbeats
from zsdist.run.last_words import RoleLog
from zsdist.run.placement import SPARE, Plan
from zsdist.run.presence import WAITS_ON_CLUSTER_S, WAITS_S, Presence
from zsdist.run.processes import ProcessIdentity
from zsdist.run.program import RoleSpec, RunSpec, Watch
from zsdist.run.ray_cluster import NodeAwayError, Places, connect
from zsdist.run.restarts import Restarts, StandbyPace
from zsdist.run.role_host import RoleHost
from zsdist.transport.base import Mailbox, Transport
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders

START_WITHIN_S = 120.0  # longest wait for the process of the hub
FIRST_WITHIN_S = 30.0  # on a cluster, for the roles that have a node each, before actors may take their room
NODE_BACK_WITHIN_S = 120.0  # longest wait for the node that has the journal of a shard of the replay
LEAVE_WITHIN_S = 5.0  # time for the roles to end by themselves once the run is over
STANDBY_AFTER_S = 1.0  # delay of the standby's start, which loads a core for seconds, after other starts
WORDS_BYTES = 2**22  # statistics that wait for the supervisor
WAITS = "Ray has not started its process yet"


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
        KeyboardInterrupt: the run was interrupted before a role without which nothing can be saved had a process.
    """
    plan = connect(spec.config)
    try:
        _Supervisor(spec, epochs, plan).run(interrupted, watch)
    finally:
        ray.shutdown()


class NodeHost(RoleHost):
    """Content of a Ray actor, which knows of which node it is."""

    def labels(self) -> Mapping[str, str]:
        """See `RoleHost.labels`."""
        found: Any = ray.get_runtime_context().get_node_labels()  # Ray declares lists of texts, and gives texts
        return dict(found)


class _Supervisor:
    """Supervisor that starts the roles, replaces those that die or stop, and reports to the scheduler."""

    def __init__(self, spec: RunSpec, epochs: Sequence[int], plan: Plan) -> None:
        self.spec = spec
        self.nodes = Places(spec.config, plan)
        self.epoch, hub_epoch, *role_epochs = epochs
        hubs = [RoleSpec("hub", "0", hub_epoch)]
        if spec.config.run.address is not None:
            branches = range(1, 1 + len(spec.config.cluster.hubs))
            hubs += [RoleSpec("hub", str(index), issue_epochs(spec.folder, 1)[0]) for index in branches]
        self.restarts = Restarts(
            [*hubs, *program.roles(spec.config, role_epochs)], lambda: issue_epochs(spec.folder, 1)[0]
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
        self.presence = Presence(WAITS_S if spec.config.run.address is None else WAITS_ON_CLUSTER_S)
        self.homeless: dict[str, float] = {}  # roles whose only node is away, and since when
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
        """Start all roles but the hub; on a cluster its actors last, which may fill any node."""
        first = [role_spec for role_spec in self.role_specs.values() if role_spec.role != "actor"]
        then = [role_spec for role_spec in self.role_specs.values() if role_spec.role == "actor"]
        for role_spec in (*first, *then):
            if role_spec is then[0] and self.spec.config.run.address is not None:
                ray.wait(list(self.asked), num_returns=len(self.asked), timeout=FIRST_WITHIN_S)
            if role_spec.name != HUB:
                self.hosts[role_spec.name] = self._host(role_spec)
                self._drive(role_spec)

    def _supervise(self, transport: Transport, interrupted: bool) -> None:
        self.guests.step(time.time())
        now = time.monotonic()
        for name in self.presence.update(self.role_specs.values(), self._is_there, now):
            self._report(transport, "role_waits", name, WAITS + self.nodes.lack(self.role_specs[name]))
        if interrupted and self.spec.config.run.address is not None and (absent := self.presence.absent(now)):
            raise KeyboardInterrupt(f"{', '.join(absent)} had not begun")
        for name, since_s in list(self.homeless.items()):
            self._look_for_home(name, since_s, now)
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
        pulse = None if place is None else place.pulse()
        reason = self.heartbeats.verdict(name, pulse, now, lambda: self.nodes.have_room(self.role_specs[name]))
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
            self.restarts.replace(name, words, time.monotonic())
        except RunError as error:
            raise RunError(log.named_in(str(error))) from None
        self.places.pop(self.hosts[name], None)
        self._report(transport, "role_replaced", name, reason)
        self.homeless[name] = time.monotonic()
        self._look_for_home(name, self.homeless[name], self.homeless[name])

    def _look_for_home(self, name: str, since_s: float, now: float) -> None:
        """Start the successor of a role, unless the only node on which it can live is away."""
        try:
            self.hosts[name] = self._stand_in(self.role_specs[name])
        except NodeAwayError as error:
            self.hosts.pop(name, None)
            if now - since_s < NODE_BACK_WITHIN_S:
                return
            raise RunError(f"{error} and has not come back within {NODE_BACK_WITHIN_S:.0f} s") from None
        del self.homeless[name]
        self._drive(self.role_specs[name])

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
        """Return the standby process; a new one where there is none or the role lives on another machine."""
        host = self.standby
        if host is None or not self.nodes.spare_serves(role_spec) or not self._stands(host):
            return self._host(role_spec)
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
            self.standby = self._host(SPARE)
            self.standby.warm_up.remote()

    def _stands(self, standby: "ray.actor.ActorHandle") -> bool:
        """Return whether the standby process works, as far as is known."""
        if standby not in self.places:
            return standby in self.asked.values()
        place = self.places[standby]
        pulse = None if place is None else place.pulse()
        return place is None or (pulse is not None and not pulse.stopped)

    def _host(self, role_spec: RoleSpec) -> "ray.actor.ActorHandle":
        options = {
            **self.nodes.options(role_spec),
            "max_restarts": 0,
            "max_concurrency": 3,  # `drive`, and `stop` or `place` meanwhile
        }
        host_class: Any = ray.remote(**options)(NodeHost)  # Ray's types cover classes only without options
        host = host_class.remote(self._spec_for(role_spec))
        self.asked[host.place.remote()] = host
        return host

    def _spec_for(self, role_spec: RoleSpec) -> RunSpec:
        """Return the specification for a process; a learner elsewhere gets its state from the newest checkpoint."""
        if role_spec.role != "learner" or self.nodes.lives_here(role_spec):
            return self.spec
        found = checkpoint_states.newest(self.spec.folder, role_spec.name)
        return self.spec if found is None else replace(self.spec, states={**self.spec.states, role_spec.name: found})

    def _leave(self) -> None:
        """Wait a while for the other roles to end by themselves."""
        names = [name for name, role_spec in self.role_specs.items() if role_spec.role == "hub"]
        others = [reference for reference, name in self.work.items() if name not in names and self._is_there(name)]
        if others:
            ray.wait(others, num_returns=len(others), timeout=LEAVE_WITHIN_S)
        stopped: list[ray.ObjectRef] = [self.hosts[name].stop.remote() for name in names if self._is_there(name)]
        ray.wait(stopped, num_returns=len(stopped), timeout=LEAVE_WITHIN_S)

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


def _last_line(error: Exception) -> str:
    """Return the last line of one of Ray's long reports, which names the cause."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1].partition(" Worker exit type:")[0] if lines else type(error).__name__
