"""Every role in one process, stepped in turn: the test mode.

Over the memory transport the clock is virtual, and two runs with one seed end in equal bits. Over zenoh the clock is
the real one, so that a single process can be watched from outside.
"""

import itertools
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial

import torch

from zsdist.roles.base import HEARTBEAT_S, Role
from zsdist.run import program
from zsdist.run.program import Place, Setting, Watch
from zsdist.transport.base import Transport
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders

TICK_S = 0.01  # of virtual time, for each round in which some role worked


def run(
    setting: Setting,
    epochs: Sequence[int],
    *,
    interrupted: Callable[[], bool] = lambda: False,
    watch: Watch = lambda transport, now: None,
) -> None:
    """Runs to the end, or until `interrupted` has been heard and everything is saved.

    Args:
        setting: what the roles share.
        epochs: fresh ones, as many as `program.epoch_count` says.
        interrupted: asked before every round.
        watch: called once a round with a transport to subscribe on and the clock, such as a progress display.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # a second thread costs these small networks more than it gives, and exactness besides
    try:
        if setting.config.transport.kind == "memory":
            broker = MemoryBroker()
            _run(
                setting, epochs, lambda place: MemoryTransport(broker, place.name), _VirtualClock(), interrupted, watch
            )
        else:
            with setting.open_hub() as hub:
                (setting.folder / "endpoint").write_text(hub.endpoint)
                connect = partial(setting.connect, endpoint=hub.endpoint)
                _run(setting, epochs, connect, _RealClock(), interrupted, watch)
    finally:
        torch.set_num_threads(threads)


class _VirtualClock:
    """Moves a tick for each round of work, and at once to the next appointment where nobody has any."""

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
    setting: Setting,
    epochs: Sequence[int],
    open_transport: Callable[[Place], Transport],
    clock: _VirtualClock | _RealClock,
    interrupted: Callable[[], bool],
    watch: Watch,
) -> None:
    places = program.roles(setting.config, epochs[2:])
    transports: list[Transport] = []
    shared_wake = threading.Event()

    def connect(place: Place) -> Transport:
        transports.append(open_transport(place))
        return transports[-1]

    try:
        supervisor = connect(program.supervisor(epochs))
        actors = [_Seat(setting, place, connect(place), shared_wake) for place in places]
        _step_all(setting, epochs[0], places, actors, supervisor, clock, shared_wake, interrupted, watch)
    finally:
        for transport in transports:
            transport.close()


class _Seat:
    """A role, when it wants to be called next, and whether mail has come for it since."""

    def __init__(self, setting: Setting, place: Place, transport: Transport, shared_wake: threading.Event) -> None:
        self.wake = _Relay(shared_wake)
        self.role: Role = setting.build(place, transport, self.wake)
        self.due_s: float | None = 0.0

    def step_if_due(self, now: float) -> bool:
        if self.due_s is None or (self.due_s > now and not self.wake.is_set()):
            return False
        self.wake.clear()
        self.due_s = self.role.step(now)
        return True


class _Relay(threading.Event):
    """An event that also sets the runner's."""

    def __init__(self, onward: threading.Event) -> None:
        super().__init__()
        self._onward = onward

    def set(self) -> None:
        super().set()
        self._onward.set()


def _step_all(
    setting: Setting,
    epoch: int,
    places: list[Place],
    seats: list[_Seat],
    supervisor: Transport,
    clock: _VirtualClock | _RealClock,
    wake: threading.Event,
    interrupted: Callable[[], bool],
    watch: Watch,
) -> None:
    scheduler = seats[0]
    next_supervision_s = clock.now
    while scheduler.due_s is not None:
        now = clock.now
        if now >= next_supervision_s:
            next_supervision_s = now + HEARTBEAT_S
            content = program.supervision(setting, places, interrupted=interrupted())
            orders = Orders(epoch, "scheduler", content)
            supervisor.publish(keys.control(setting.run, "scheduler"), codec.encode(orders), retained=True)
        worked = [seat.step_if_due(now) for seat in seats]
        watch(supervisor, now)
        appointments = [seat.due_s for seat in seats if seat.due_s is not None]
        clock.after(any(worked), min(itertools.chain(appointments, [next_supervision_s])), wake)
