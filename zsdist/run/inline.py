"""Runner of all roles in one process, stepped in turn: the test mode.

Over the memory transport the clock is virtual, and two runs with one seed are bit-identical. Over zenoh the clock is
real, so that a single process can be watched from outside.
"""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial

import torch

from zsdist.errors import RunError, ZsdistError
from zsdist.roles.base import HEARTBEAT_S, Role
from zsdist.run import directory, program
from zsdist.run.guests import Guests
from zsdist.run.program import RoleSpec, RunSpec, Watch
from zsdist.transport.base import Transport
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders

TICK_S = 0.01  # virtual time for each round in which some role worked


def run(
    spec: RunSpec,
    epochs: Sequence[int],
    *,
    interrupted: Callable[[], bool] = lambda: False,
    watch: Watch = lambda transport, now: None,
) -> None:
    """Run to the end, or until an interruption is noticed and everything is saved.

    Args:
        spec: specification of the run.
        epochs: new epochs, as many as `program.epoch_count` returns.
        interrupted: tells whether to stop early; called once a heartbeat.
        watch: called once a round with a transport to subscribe on and the clock, such as a progress display.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # for networks this small a second thread is slower, and not reproducible
    try:
        if spec.config.transport.kind == "memory":
            broker = MemoryBroker()
            _run(
                spec,
                epochs,
                lambda role_spec: MemoryTransport(broker, role_spec.name),
                _VirtualClock(),
                interrupted,
                watch,
            )
        else:
            with spec.open_hub() as hub:
                (spec.folder / "endpoint").write_text(hub.endpoint, encoding="utf-8")
                connect = partial(spec.connect, endpoint=hub.endpoint)
                _run(spec, epochs, connect, _RealClock(), interrupted, watch)
    finally:
        torch.set_num_threads(threads)


class _VirtualClock:
    """Clock that advances by a tick after each round of work, and to the next due time where no role has work."""

    def __init__(self) -> None:
        self.now = 0.0

    def after(self, worked: bool, next_s: float, wake: threading.Event) -> None:
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


def _run(
    spec: RunSpec,
    epochs: Sequence[int],
    open_transport: Callable[[RoleSpec], Transport],
    clock: _VirtualClock | _RealClock,
    interrupted: Callable[[], bool],
    watch: Watch,
) -> None:
    role_specs = program.roles(spec.config, epochs[2:])
    transports: list[Transport] = []
    shared_wake = threading.Event()

    def connect(role_spec: RoleSpec) -> Transport:
        transports.append(open_transport(role_spec))
        return transports[-1]

    try:
        supervisor = connect(program.supervisor(epochs))
        hosted = [_HostedRole(spec, role_spec, connect(role_spec), shared_wake) for role_spec in role_specs]
        _step_all(spec, epochs[0], role_specs, hosted, supervisor, clock, shared_wake, interrupted, watch)
    finally:
        for transport in transports:
            transport.close()


class _HostedRole:
    """Role with the time at which its next step is due, and whether a message has arrived since the last step."""

    def __init__(self, spec: RunSpec, role_spec: RoleSpec, transport: Transport, shared_wake: threading.Event) -> None:
        self.wake = _RelayedEvent(shared_wake)
        self._role_spec = role_spec
        with self._named():
            self.role: Role = spec.build(role_spec, transport, self.wake)
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


def _step_all(
    spec: RunSpec,
    epoch: int,
    role_specs: list[RoleSpec],
    hosted: list[_HostedRole],
    supervisor: Transport,
    clock: _VirtualClock | _RealClock,
    wake: threading.Event,
    interrupted: Callable[[], bool],
    watch: Watch,
) -> None:
    scheduler = hosted[0]
    guests = Guests(spec, supervisor, lambda: directory.issue_epochs(spec.folder, 1)[0])
    next_supervision_s = clock.now
    while scheduler.due_s is not None:
        now = clock.now
        if now >= next_supervision_s:
            next_supervision_s = now + HEARTBEAT_S
            guests.step(now)
            content = program.supervision(role_specs, interrupted=interrupted(), guests=guests.epochs, left=guests.left)
            orders = Orders(epoch, "scheduler", content)
            supervisor.publish(keys.control(spec.run, "scheduler"), codec.encode(orders), retained=True)
        worked = [role.step_if_due(now) for role in hosted]
        watch(supervisor, now)
        due_s = [role.due_s for role in hosted if role.due_s is not None]
        clock.after(any(worked), min([*due_s, next_supervision_s]), wake)
