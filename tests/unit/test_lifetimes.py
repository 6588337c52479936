"""Objects that hold something: dropped without `close`, closed twice, copied, pickled and forked."""

import ast
import copy
import gc
import multiprocessing
import os
import pickle
import traceback
import weakref
from pathlib import Path

import numpy as np
import psutil
import pytest
from sockets import free_endpoint

import zsdist
from zsdist.config import CameraConfig, parse
from zsdist.errors import SimulationError, TransportError
from zsdist.recording.log import Log
from zsdist.replay.journal import Journal
from zsdist.ros2.node import RosNode
from zsdist.run.board import Board
from zsdist.run.directory import RunDirectory
from zsdist.run.episodes_file import EpisodesFile
from zsdist.run.figures_file import FiguresFile
from zsdist.sim.bullet import Client, pybullet
from zsdist.sim.camera import make_camera
from zsdist.sim.env import CarNavigation
from zsdist.sim.physics.world import World
from zsdist.sim.scenes import families
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.transport.zenoh import ZenohHub, ZenohTransport
from zsdist.types import LatticeState
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.vision.reading_cache import ReadingCache

CONFIG = parse({"camera": {"size_px": 32}})
SCENE = families.draw("iid", "train", 0)


def env(back_end):
    made = CarNavigation(config=parse({"camera": {"size_px": 32, "back_end": back_end}}))
    made.reset(seed=0)
    return made


def camera(back_end):
    made = make_camera(CameraConfig(size_px=32, back_end=back_end))
    made.render(SCENE, SCENE.start.pose)
    return made


def journal(folder):
    made = Journal(folder / "journal")
    made.rebase(b"base")
    return made


def run_directory(folder):
    made = RunDirectory(folder, VisionIdentity("e", "0" * 64, "head", "0" * 64))
    made.metrics({"env_steps": 1, "time_s": 0.0})
    return made


COPIED = {  # how each is made; copies and pickles are independent
    "CarNavigation": lambda folder: env("caster"),
    "CarNavigation, pybullet": lambda folder: env("pybullet"),
    "CasterCamera": lambda folder: camera("caster"),
    "TinyCamera": lambda folder: camera("pybullet"),
    "World": lambda folder: World(env("caster").grid),
    "ReadingCache": lambda folder: ReadingCache(2**20, "vision"),
}
OWNED = {  # copies and pickles are refused
    "Journal": journal,
    "MemoryTransport": lambda folder: MemoryTransport(MemoryBroker()),
    "Board": lambda folder: Board(folder / "board"),
    "EpisodesFile": lambda folder: EpisodesFile(folder / "episodes.jsonl"),
    "FiguresFile": lambda folder: FiguresFile(folder / "figures.jsonl"),
    "Log": lambda folder: Log(folder / "log.mcap"),
    "RosNode": lambda folder: RosNode("node", connect=folder.hub.endpoint),
    "RunDirectory": run_directory,
    "ZenohHub": lambda folder: ZenohHub(free_endpoint()),
    "ZenohTransport": lambda folder: ZenohTransport(folder.hub.endpoint),
}
TESTED_WITH_THEIR_OWNER = {
    "Client": "World and TinyCamera",
    "Perception": "its ReadingCache",
    "LevelJournal": "its Journal",
    "Belongings": "its RunDirectory",
    "EpisodeFile": "its Log",
    "Runner": "the transports of its roles",
    "Link": "ZenohTransport",
    "Fetcher": "ZenohTransport",
    "Logbook": "its Log",
    "RosPublisher": "its RosNode",
    "SimulatedRobot": "its RosNode and its World",
    "RerunLog": "its stream, which Rerun holds (tests/unit/reporting/test_rerun_log.py)",
    "WebServer": "its server, which holds no file (tests/unit/web/test_server.py)",
    "Exporter": "its server, which holds no file (tests/unit/telemetry/test_prometheus.py)",
}
HOLDS_NOTHING = {  # `close` ends a stream, an epoch, a bar or a thread; or an interface; or a process of Ray
    "ActorOutboxes", "Camera", "CameraEnv", "Display", "DriveLoop", "Inbox", "Limiter", "Outbox",
    "PretrainingProgress", "Recorder", "RoleHost", "StepProgress", "TrajectoryBuilder", "Transport", "_ThreadedPolicy",
}  # fmt: skip


def with_close():
    """Names of the classes of the package that have a method to close them."""
    package = Path(zsdist.__file__).parent
    return {
        node.name
        for path in package.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef)
        and any(isinstance(item, ast.FunctionDef) and item.name in ("close", "__exit__", "stop") for item in node.body)
    }


def test_every_class_that_can_be_closed_is_tested_here():
    tested = {name.split(",")[0] for name in (*COPIED, *OWNED)}
    assert with_close() - tested - set(TESTED_WITH_THEIR_OWNER) == HOLDS_NOTHING


class Folder(type(Path())):
    """Path with a hub."""

    hub = None


@pytest.fixture(scope="module")
def hub():
    with ZenohHub(free_endpoint()) as made:
        yield made


@pytest.fixture
def folder(tmp_path, hub):
    made = Folder(tmp_path)
    made.hub = hub
    return made


def held():
    """Open files other than sockets and their kin, threads of Python, and clients of PyBullet."""
    links = [Path(f"/proc/self/fd/{number}") for number in os.listdir("/proc/self/fd")]
    files = [os.readlink(link) for link in links if link.exists()]
    clients = sum(pybullet.getConnectionInfo(number)["isConnected"] for number in range(32))
    return sorted(name for name in files if name.startswith("/")), clients


@pytest.mark.parametrize("name", [*COPIED, *OWNED])
@pytest.mark.parametrize("end", ["dropped", "closed twice"])
def test_nothing_stays_open(name, end, folder):
    gc.collect()
    before = held()
    made = (COPIED | OWNED)[name](folder)
    gone = weakref.ref(made)
    if end == "closed twice":
        made.close()
        made.close()
    del made
    gc.collect()
    assert gone() is None
    assert held() == before


@pytest.mark.parametrize("name", OWNED)
@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, pickle.dumps])
def test_what_belongs_to_one_process_is_not_copied(name, duplicate, folder):
    made = OWNED[name](folder)
    with pytest.raises(TypeError, match=f"a {name} can be neither copied nor pickled, since it holds an open file"):
        duplicate(made)
    made.close()


@pytest.mark.parametrize("name", COPIED)
@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda made: pickle.loads(pickle.dumps(made))])
def test_a_copy_outlives_its_original(name, duplicate, folder):
    made = COPIED[name](folder)
    other = duplicate(made)
    made.close()
    match other:
        case CarNavigation():
            other.step(0)
        case World():
            other.reset(SCENE)
        case ReadingCache():
            assert other.find("scene", LatticeState(0, 0, 0)) is None
        case _:
            assert (other.render(SCENE, SCENE.start.pose) == COPIED[name](folder).render(SCENE, SCENE.start.pose)).all()
            with pytest.raises(RuntimeError, match="the camera is closed; make another one"):
                made.render(SCENE, SCENE.start.pose)
    other.close()


def in_a_fork(work):
    """Return what `work` returned or raised in a forked process, as text; it must end by itself."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()

    def run():
        try:
            theirs.send(work())
        except Exception as error:
            theirs.send(traceback.format_exception_only(error)[-1].strip())

    child = context.Process(target=run)
    child.start()
    assert ours.poll(60)
    answer = ours.recv()
    child.join(60)
    assert child.exitcode == 0
    return answer


def test_a_forked_process_drives_and_draws_on_copies_of_its_own():
    for back_end in ("caster", "pybullet"):
        made = env(back_end)

        def drive(made=made):
            steps = [made.step(action)[0] for action in (0, 1, 0)]
            return [(step["pose"].tolist(), step["image"].tobytes()) for step in steps]

        assert in_a_fork(drive) == in_a_fork(drive) == drive()
        made.close()


def test_a_forked_process_cannot_use_what_belongs_to_its_parent(folder):
    made, log = journal(folder), run_directory(folder)
    message = f"belongs to process {os.getpid()}; a process forked from it needs its own"
    assert message in in_a_fork(lambda: made.append([(1, b"record")]))
    assert message in in_a_fork(lambda: log.metrics({}))
    made.append([(1, b"ours")])
    made.close()
    assert Journal(folder / "journal").recover().records == [(1, b"ours")]
    transport = ZenohTransport(folder.hub.endpoint)

    def publish():
        try:
            transport.publish("a/b", b"")
        finally:
            transport.close()

    assert TransportError.__name__ in (answer := in_a_fork(publish))
    assert "was opened before a fork; open another one after it" in answer
    transport.publish("a/b", b"")
    transport.close()


def test_a_forked_process_that_ends_like_any_other_does_not_wait_for_sessions_of_its_parent(folder):
    transport = ZenohTransport(folder.hub.endpoint)
    assert in_a_fork(lambda: transport.__dict__.clear()) is None  # drops the session there
    transport.publish("a/b", b"")
    transport.close()


def test_the_port_of_a_dropped_hub_is_free():
    endpoint = free_endpoint()
    ZenohHub(endpoint)
    gc.collect()
    ZenohHub(endpoint, ports_tried=1).close()


def test_a_dropped_transport_in_memory_takes_its_tokens_and_mailboxes_along():
    broker, box = MemoryBroker(), Mailbox(1000)
    watcher, other = MemoryTransport(broker), MemoryTransport(broker)
    watcher.watch_alive("alive/*", box)
    other.declare_alive("alive/x")
    del other
    assert [message.payload for message in box.drain()] == [b"1", b"0"]
    assert broker.transports == [watcher]


@pytest.mark.parametrize("back_end", ["caster", "pybullet"])
def test_environments_that_are_made_reset_and_dropped_take_no_memory(back_end):
    process, sizes = psutil.Process(), []
    for number in range(24):
        trees = tuple(Obstacle("tree", float(x), number / 4, 0.5) for x in range(3))
        scene = Scene("trees", "grass", Start(-8.0, -8.0, 0.0), (8.0, 8.0), trees)
        CarNavigation(config=parse({"camera": {"size_px": 32, "back_end": back_end}})).reset(options={"scene": scene})
        sizes.append(process.memory_info().rss / 2**20)
    assert np.mean(sizes[-4:]) - np.mean(sizes[10:14]) < 10  # one client is 28 MiB, the meshes of three trees are 5


def test_the_limit_of_clients_is_met_in_one_line_and_after_cycles_were_released(monkeypatch):
    offered = iter([-1, 7])
    monkeypatch.setattr(pybullet, "connect", lambda mode: next(offered))
    monkeypatch.setattr(pybullet, "disconnect", lambda number: None)
    assert Client().number == 7

    def refuse(mode):
        raise pybullet.error("Exceeding maximum number of physics connections.")

    monkeypatch.setattr(pybullet, "connect", refuse)
    with pytest.raises(SimulationError, match="PyBullet allows no further client in this process; close environments"):
        CarNavigation(config=CONFIG)


def test_a_constructor_that_fails_holds_nothing(monkeypatch):
    gc.collect()
    before = held()
    for broken in ("zsdist.sim.env.make_camera", "zsdist.sim.physics.world.CarBody"):
        with monkeypatch.context() as patch:
            patch.setattr(broken, lambda *_: 1 / 0)
            with pytest.raises(ZeroDivisionError):
                CarNavigation(config=CONFIG)
    gc.collect()
    assert held() == before
