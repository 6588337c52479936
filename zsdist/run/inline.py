"""Runner of all roles in one process, stepped in turn: the test mode.

Over the memory transport the clock is virtual, and two runs with one seed are bit-identical, however often one of them
was stopped and resumed (`zsdist.run.sittings`). Over zenoh the clock is real, so that a single process can be watched
from outside.
"""

import shutil
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial

import torch

from zsdist.errors import RunError, ZsdistError
from zsdist.roles.base import HEARTBEAT_S, Role
from zsdist.roles.scheduler.role import Scheduler
from zsdist.run import checkpoint_files, directory, program, sittings
from zsdist.run.guests import Guests
from zsdist.run.program import RoleSpec, RunSpec, Watch
from zsdist.transport.base import Transport
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders

TICK_S = 0.01  # virtual time for each round in which some role worked

Build = Callable[[RunSpec, RoleSpec, Transport, threading.Event], Role]
Connect = Callable[[RoleSpec], Transport]


def run(
    spec: RunSpec,
    epochs: Sequence[int],
    *,
    interrupted: Callable[[], bool] = lambda: False,
    watch: Watch = lambda transport, now: None,
) -> None:
    """Run to the end, or until an interruption is noticed.

    Over zenoh everything is saved then. Over the memory transport the run ends at once, as it was at the last
    checkpoint; resumed, it drives what came after that again.

    Args:
        spec: specification of the run.
        epochs: new epochs, as many as `program.epoch_count` returns.
        interrupted: tells whether to stop early; called at least once a heartbeat.
        watch: called once a round with a transport to subscribe on and the clock, such as a progress display.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # for networks this small a second thread is slower, and not reproducible
    try:
        if spec.config.transport.kind == "memory":
            _run_in_sittings(spec, epochs, interrupted, watch)
        else:
            with spec.open_hub() as hub:
                (spec.folder / "endpoint").write_text(hub.endpoint, encoding="utf-8")
                connect = partial(spec.connect, endpoint=hub.endpoint)
                with closing(connect(program.supervisor(epochs))) as supervisor:
                    guests = Guests(spec, supervisor, lambda: directory.issue_epochs(spec.folder, 1)[0])
                    runner = Runner(spec, epochs, supervisor, connect, RunSpec.build, guests=guests)
                    with closing(runner):
                        runner.run(_RealClock(), interrupted, watch)
    finally:
        torch.set_num_threads(threads)


def _run_in_sittings(spec: RunSpec, epochs: Sequence[int], interrupted: Callable[[], bool], watch: Watch) -> None:
    broker, states, begun = MemoryBroker(), spec.states, 0

    def connect(role_spec: RoleSpec) -> Transport:
        return MemoryTransport(broker, role_spec.name)

    with (
        closing(sittings.Belongings(spec)) as belongings,
        closing(connect(program.supervisor(epochs))) as supervisor,
    ):
        while not sittings.is_complete(spec.config, states):
            start = uuid.uuid4().hex  # of journals: no role goes on with those of the sitting before
            sitting, until = replace(spec, states=dict(states), start=start), sittings.end(spec.config, states)
            with closing(Runner(sitting, epochs, supervisor, connect, belongings.build, until)) as runner:
                # The first checkpoint is awaited, since an interrupted run has to have one.
                stop = interrupted if states else lambda: False
                ended = runner.run(VirtualClock(sittings.time_s(states)), lambda: False, watch, stop)
                begun = runner.begun
            del runner, sitting  # before the roles of the next sitting take as much memory
            if not ended:
                break
            shutil.rmtree(spec.folder / "journal", ignore_errors=True)  # of roles that have ended
            # Read back, so that the next sitting begins as that of a resumed run would.
            states = checkpoint_files.read_checkpoint(checkpoint_files.newest_checkpoint(spec.folder))
            epochs = directory.issue_epochs(spec.folder, len(epochs))
    sittings.conclude(spec, states, begun)


class VirtualClock:
    """Clock that advances by a tick after each round of work, and to the next due time where no role has work."""

    def __init__(self, now: float) -> None:
        self.now = now

    def after(self, worked: bool, next_s: float, wake: threading.Event) -> None:
        """Advance after a round of all roles; `next_s` is the time of the next work."""
        self.now = self.now + TICK_S if worked else max(self.now, next_s)


class _RealClock:
    """Unix time that never runs backwards."""

    def __init__(self) -> None:
        self._offset_s = time.time() - time.monotonic()

    @property
    def now(self) -> float:
        return self._offset_s + time.monotonic()

    def after(self, worked: bool, next_s: float, wake: threading.Event) -> None:
        if not worked:
            wake.wait(max(0.0, next_s - self.now))
            wake.clear()


class Runner:
    """All roles, with their transports, stepped in turn.

    Args:
        spec: specification of the run.
        epochs: epochs of the runner, the hub and each role.
        supervisor: transport on which the scheduler is told how the run stands.
        connect: function that opens the transport of a role.
        build: function that builds a role.
        until: number of finished episodes at which all roles close; None: that of the whole run.
        guests: actors that may join from elsewhere; None: none may.
    """

    def __init__(
        self,
        spec: RunSpec,
        epochs: Sequence[int],
        supervisor: Transport,
        connect: Connect,
        build: Build,
        until: int | None = None,
        guests: Guests | None = None,
    ) -> None:
        self._run, self._epoch, self._until, self._guests = spec.run, epochs[0], until, guests
        self._supervisor = supervisor
        self._role_specs = program.roles(spec.config, epochs[2:])
        self._transports: list[Transport] = []
        self._hosted: list[_HostedRole] = []
        self._wake = threading.Event()
        self._supervise(interrupted=False)  # before the scheduler looks for the last orders
        try:
            for role_spec in self._role_specs:
                self._transports.append(connect(role_spec))
                self._hosted.append(_HostedRole(spec, role_spec, self._transports[-1], self._wake, build))
        except BaseException:
            self.close()
            raise

    @property
    def begun(self) -> int:
        """Number of training episodes that are finished or granted to an actor."""
        scheduler = self._hosted[0].role
        assert isinstance(scheduler, Scheduler), "the scheduler is the first role"
        return scheduler.finished_episodes + len(scheduler.progress.leases.holders)

    def run(
        self,
        clock: VirtualClock | _RealClock,
        interrupted: Callable[[], bool],
        watch: Watch,
        stop: Callable[[], bool] = lambda: False,
    ) -> bool:
        """Step all roles until the scheduler has finished.

        Args:
            clock: clock of all roles.
            interrupted: tells whether the scheduler is to end the run.
            watch: called once a round.
            stop: tells, once a round, whether to stop at once.

        Returns:
            Whether the scheduler has finished.
        """
        scheduler, next_supervision_s = self._hosted[0], clock.now
        while scheduler.due_s is not None:
            now = clock.now
            if now >= next_supervision_s:
                next_supervision_s = now + HEARTBEAT_S
                if self._guests is not None:
                    self._guests.step(now)
                self._supervise(interrupted())
            worked = [role.step_if_due(now) for role in self._hosted]
            stopped = stop()
            watch(self._supervisor, now)
            if stopped:
                return False
            due_s = [role.due_s for role in self._hosted if role.due_s is not None]
            clock.after(any(worked), min([*due_s, next_supervision_s]), self._wake)
        return True

    def close(self) -> None:
        """Close the transports of all roles."""
        for transport in self._transports:
            transport.close()

    def _supervise(self, interrupted: bool) -> None:
        content = program.supervision(
            self._role_specs,
            interrupted=interrupted,
            until=self._until,
            guests=self._guests.epochs if self._guests else None,
            left=self._guests.left if self._guests else None,
        )
        orders = codec.encode(Orders(self._epoch, "scheduler", content))
        self._supervisor.publish(keys.control(self._run, "scheduler"), orders, retained=True)


class _HostedRole:
    """Role with the time at which its next step is due, and whether a message has arrived since the last step."""

    def __init__(
        self, spec: RunSpec, role_spec: RoleSpec, transport: Transport, shared_wake: threading.Event, build: Build
    ) -> None:
        self.wake = _RelayedEvent(shared_wake)
        self._role_spec = role_spec
        with self._named():
            self.role: Role = build(spec, role_spec, transport, self.wake)
        self.due_s: float | None = 0.0

    def step_if_due(self, now: float) -> bool:
        if self.due_s is None or (self.due_s > now and not self.wake.is_set()):
            return False
        self.wake.clear()
        with self._named():
            self.due_s = self.role.step(now)
        return True

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Name the role in the errors that end the run, as the Ray runner does."""
        try:
            yield
        except ZsdistError as error:
            raise RunError(self._role_spec.reason(error)) from error


class _RelayedEvent(threading.Event):
    """Event that also sets the runner's event."""

    def __init__(self, shared: threading.Event) -> None:
        super().__init__()
        self._shared = shared

    def set(self) -> None:
        super().set()
        self._shared.set()
