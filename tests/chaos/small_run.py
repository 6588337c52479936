"""Small distributed run with kinematic cars, for the scripts of this folder: its processes, its cars, its messages.

The run is a process of its own (`launcher.py`), so that everything of it can be killed. Each car counts its actions in
an append-only file of its process: what has really been driven, whatever messages and files say later.
"""

import contextlib
import functools
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import psutil
import tamper
from fakes import FakeVisualAct, LatticeEnv
from synthetic import SyntheticActor

from zsdist.errors import DecodeError, TransportError
from zsdist.roles import base
from zsdist.run import directory, role_host
from zsdist.run.processes import ROLE_THREAD
from zsdist.run.program import ActorParts, RunSpec
from zsdist.run.scene_schedule import SceneSchedule
from zsdist.transport.base import Mailbox
from zsdist.transport.certificates import Identity
from zsdist.transport.zenoh import ZenohTransport
from zsdist.wire import codec, keys
from zsdist.wire.messages import Ack, Orders, Priorities

HERE = Path(__file__).parent
PATHS = [str(path) for path in (HERE, HERE.parent, HERE.parents[1])]  # in which all its processes find modules
ACTION_S = 0.002  # pause in each action: cars that are slower than the replay, as real ones are
LIGHT = (
    "transport.endpoint=tcp/127.0.0.1:7700",
    "run.actors=1",
    "run.cars_per_actor=2",
    "run.episodes=1000000",
    "run.checkpoint_every_episodes=1000000",
    "run.checkpoint_every_s=20",
    "run.final_evaluation_episodes=0",
    "sim.max_steps=40",
    "agent.option_max_steps=8",
    "merge.every_episodes=0",
    "low.hidden=[16]",
    "high.hidden=[16]",
    "low.updates_per_insert=0.05",
    "high.updates_per_insert=0.05",
    "scenes.train=[singleton]",
    "replay.adaptive=false",
    "replay.prioritised=true",  # so that every update is heard
    "replay.size_initial=60000",
    "replay.size_max=60000",
)
UNLIMITED = "ZSDIST_CHAOS_RESTARTS"  # variable: number of restarts that `launcher.py` allows
_write = os.write  # `tamper` slows the disk for others
STEPS = "ZSDIST_CHAOS_STEPS"  # variable: folder of the files in which cars count their actions
SYNTHETIC = "ZSDIST_CHAOS_SYNTHETIC"  # variable: if it is set, actors have no cars
MACHINE = "ZSDIST_CHAOS_MACHINE"  # variable: name of the machine that processes believe to be on
PROXIES = "ZSDIST_CHAOS_PROXIES"  # variable: JSON, ports of the proxies through which kinds of roles connect
LOOK_EVERY_S = 0.2
REST_S = 0.6  # time without much computing after which a process counts as waiting
END_WITHIN_S = 120.0


if MACHINE in os.environ:
    base.HOST = role_host.HOST = os.environ[MACHINE]


class CountedEnv(LatticeEnv):
    """Kinematic car that appends a byte to a file of its process at each action."""

    def __init__(self, config):
        super().__init__(config=config)
        self._file = None

    def step(self, action):
        if self._file is None:
            self._path = Path(os.environ[STEPS]) / f"{os.getpid()}-{id(self)}"
            self._file = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        _write(self._file, b".")
        time.sleep(ACTION_S)
        return super().step(action)

    def close(self):
        if self._file is not None:  # a stand-in that is tried out; an actor's cars are never closed
            os.close(self._file)
            self._path.unlink(missing_ok=True)


def counted(settings):
    """Return the parts of an actor with counted cars."""
    return ActorParts(functools.partial(CountedEnv, settings), FakeVisualAct(), SceneSchedule(settings))


class DisturbedRunSpec(RunSpec):
    """Specification of a run whose roles connect to the hub through proxies, and whose clock and disk can change."""

    def open_hub(self, endpoint=None):
        """See `RunSpec.open_hub`."""
        tamper.install()
        return super().open_hub(endpoint)

    def connect(self, role_spec, endpoint):
        """See `RunSpec.connect`."""
        tamper.install()
        port = json.loads(os.environ.get(PROXIES, "{}")).get(role_spec.role)
        return super().connect(role_spec, endpoint if port is None else f"tcp/127.0.0.1:{port}")

    def build(self, role_spec, transport, wake, parts=None):
        """See `RunSpec.build`."""
        if role_spec.role == "actor" and SYNTHETIC in os.environ:
            return SyntheticActor(self.context(role_spec, transport, wake))
        return super().build(role_spec, transport, wake, parts)


def actions(folder: Path, pid: int) -> int:
    """Return the number of actions that the cars of a process have driven."""
    return sum(path.stat().st_size for path in folder.glob(f"{pid}-*"))


class Launcher:
    """Process of a run, and all that it has started.

    Args:
        root: folder in which the run directory `run` lies, and beside it the files of the cars.
        settings: settings other than `LIGHT`.
        restarts: number of restarts of a role that are allowed; None: the usual one.
        command: command of another run in the same place; None: `launcher.py` with the settings.
    """

    def __init__(
        self, root: Path, *settings: str, restarts: int | None = None, command: Sequence[str] | None = None
    ) -> None:
        self.root, self.folder = root, root / "run"
        (root / "steps").mkdir(parents=True, exist_ok=True)
        (self.folder / "endpoint").unlink(missing_ok=True)
        path = os.pathsep.join([*PATHS, *filter(None, [os.environ.get("PYTHONPATH")])])
        environment = os.environ | {"PYTHONPATH": path, STEPS: str(root / "steps")}
        if restarts is not None:
            environment[UNLIMITED] = str(restarts)
        self.log = root / "launcher.log"
        command = command or [sys.executable, str(HERE / "launcher.py"), str(self.folder), *settings]
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(command, env=environment, stdout=log, stderr=log, start_new_session=True)
        self.known: dict[int, psutil.Process] = {}
        self._look_s, self._standby_kib = 0.0, None
        self._looks: list[tuple[int, float, float]] = []  # at the standby: process, time, its processor time
        self.note_family()

    def note_family(self) -> list[psutil.Process]:
        """Note and return all living processes of the run."""
        with contextlib.suppress(psutil.NoSuchProcess):
            for process in [top := psutil.Process(self.process.pid), *top.children(recursive=True)]:
                self.known.setdefault(process.pid, process)
        return self.left()

    def left(self) -> list[psutil.Process]:
        """Return the noted processes that live, zombies aside."""
        self.process.poll()
        living = []
        for process in self.known.values():
            with contextlib.suppress(psutil.Error):
                if process.is_running() and process.status() != psutil.STATUS_ZOMBIE:
                    living.append(process)
        return living

    def kill(self, *, alone: bool) -> None:
        """Kill the launcher with SIGKILL, and all that it has started at the same moment, unless `alone`."""
        family = self.note_family()
        self.process.kill()
        for process in () if alone else family:
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()
        self.process.wait()

    def stop(self, number: int = signal.SIGINT) -> int:
        """Ask the run to save and end; return its exit status."""
        self.note_family()
        self.process.send_signal(number)
        return self.wait()

    def wait(self, timeout_s: float = END_WITHIN_S) -> int:
        """Return the exit status once it has ended."""
        return self.process.wait(timeout_s)

    def require_running(self) -> None:
        """Raise `AssertionError` with the end of its log where the run has ended."""
        if self.process.poll() is not None:
            raise AssertionError(f"the run has ended with {self.process.returncode}: {self.last_words()}")

    def last_words(self) -> str:
        """Return the end of the launcher's output."""
        return " | ".join(self.log.read_text(errors="replace").splitlines()[-4:])

    def standby_kib(self) -> int | None:
        """Return the resident KiB of the process that waits to replace another one; None: there is none yet.

        A process that still starts, so that it computes, does not wait. Processes are looked at five times a second.
        """
        if time.monotonic() >= self._look_s:
            self._look_s = time.monotonic() + LOOK_EVERY_S
            self._standby_kib = self._find_standby()
        return self._standby_kib

    def _find_standby(self) -> int | None:
        with contextlib.suppress(psutil.Error):
            for process in psutil.Process(self.process.pid).children(recursive=True):
                with contextlib.suppress(psutil.Error, OSError):
                    if " ".join(process.cmdline()).startswith("ray::NodeHost") and not _has_role(process.pid):
                        return process.memory_info().rss // 1024 if self._rests(process) else None
        return None

    def _rests(self, process: psutil.Process) -> bool:
        """Return whether a process has computed for at most a tenth of the time for a while."""
        now, times = time.monotonic(), process.cpu_times()
        self._looks = [look for look in self._looks if look[0] == process.pid and look[1] >= now - 2 * REST_S]
        self._looks.append((process.pid, now, times.user + times.system))
        earlier = [used_s for _, time_s, used_s in self._looks if time_s <= now - REST_S]
        return bool(earlier) and times.user + times.system - earlier[-1] <= 0.1 * REST_S


def _has_role(pid: int) -> bool:
    """Return whether a process has been given a role."""
    return any((task / "comm").read_text().strip() == ROLE_THREAD for task in Path(f"/proc/{pid}/task").iterdir())


class Witness:
    """Listener at the hub of a run.

    Args:
        launcher: start of the run.
        identity: certificate with which it connects; None: the run has none.

    Attributes:
        statistics: newest statistics of each role by name.
        pids: process of each incarnation of an actor, by name and epoch.
        acknowledged: number of frames that were acknowledged, by stream, actor and epoch.
        orders: newest epoch of the scheduler whose orders were heard, and the time of its first ones.
        updates: newest epoch of each level's learner of which an update was heard, and the time of its first one.
        events: all events.
    """

    def __init__(self, launcher: Launcher, identity: Identity | None = None) -> None:
        self.statistics: dict[str, dict] = {}
        self.pids: dict[tuple[str, int], int] = {}
        self.acknowledged: dict[tuple[str, str, int], int] = {}
        self.orders = (-1, 0.0)
        self.updates: dict[str, tuple[int, float]] = {}
        self.events: list[dict] = []
        self._identity = identity
        self._box: Mailbox | None = None
        self._transport: ZenohTransport | None = None
        self.attach(launcher)

    def attach(self, launcher: Launcher) -> None:
        """Listen to another start of the run; what was heard of the earlier ones is kept, except statistics."""
        self.close()
        self.statistics.clear()
        self._launcher, self._run = launcher, directory.key_name(launcher.folder)

    def close(self) -> None:
        """Stop listening."""
        if self._transport is not None:
            self.poll()
            self._transport.close()
            self._transport = None

    def poll(self) -> None:
        """Take in what has been heard since."""
        if self._transport is None and not self._connect():
            return
        now = time.time()
        for message in self._box.drain():
            kind = message.key.split("/")[2]
            if kind == "stats":
                self._take(json.loads(message.payload))
            elif kind == "events":
                self.events.append(json.loads(message.payload))
            else:
                with contextlib.suppress(DecodeError):
                    self._hear(codec.decode(message.payload), now)

    def name_of(self, role: str) -> list[str]:
        """Return the names of the roles of a kind."""
        return sorted(name for name in self.statistics if name.split("-")[0] == role)

    def _connect(self) -> bool:
        endpoint = self._launcher.folder / "endpoint"
        if not endpoint.exists() or not (address := endpoint.read_text()):
            return False
        try:
            self._transport = ZenohTransport(address, self._identity, connect_timeout_s=0.5)
        except TransportError:
            return False
        self._box = Mailbox(2**28)
        for pattern in (
            keys.stats(self._run, keys.ANY, keys.ANY),
            keys.events(self._run),
            keys.ack(self._run, keys.ANY),
            keys.control(self._run, "actor"),
            keys.priority(self._run, keys.ANY),
        ):
            self._transport.subscribe(pattern, self._box)
        return True

    def _take(self, statistics: dict) -> None:
        name = f"{statistics['role']}-{statistics['id']}"
        if statistics["epoch"] >= self.statistics.get(name, {}).get("epoch", -1):
            self.statistics[name] = statistics
        if statistics["role"] == "actor":
            self.pids[name, statistics["epoch"]] = statistics["pid"]

    def _hear(self, message: object, now: float) -> None:
        match message:
            case Ack():
                stream = (str(message.stream), message.actor, message.epoch)
                self.acknowledged[stream] = max(self.acknowledged.get(stream, 0), message.received)
            case Orders() if message.sender_epoch > self.orders[0]:
                self.orders = (message.sender_epoch, now)
            case Priorities() if message.sender_epoch > self.updates.get(str(message.level), (-1, 0.0))[0]:
                self.updates[str(message.level)] = (message.sender_epoch, now)


def wait_for(condition: Callable[[], bool], patience_s: float, what: str, poll: Callable[[], None]) -> float:
    """Poll until a condition holds; return the seconds that it took.

    Raises:
        AssertionError: it does not hold in time.
    """
    start_s = time.time()
    while not condition():
        assert time.time() - start_s < patience_s, f"{what} did not happen within {patience_s:g} s"
        poll()
        time.sleep(0.005)
    return time.time() - start_s


def end_cleanly() -> None:
    """Let SIGTERM end this script like Ctrl-C, so that it leaves no process."""
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))


def moments(seed: int) -> random.Random:
    """Return the source of random moments and victims."""
    return random.Random(seed)
