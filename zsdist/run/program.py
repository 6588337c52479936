"""The composition root: which roles a run has, and how each is built. No role knows where it lives."""

import threading
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zsdist.agent import features
from zsdist.agent.hierarchy import q_functions
from zsdist.common import code_hash
from zsdist.config import Config
from zsdist.dqn import network
from zsdist.driving.actor_car import ActorCar, CameraEnv, EpisodeTask
from zsdist.driving.perception import Perception, VisionModel
from zsdist.errors import ConfigError, SceneError, WeightsError
from zsdist.planning.grid import Grid
from zsdist.replay.buffer import row_bytes
from zsdist.roles import permissions
from zsdist.roles.actor import Actor
from zsdist.roles.base import Context, Role
from zsdist.roles.hub import Hub
from zsdist.roles.replay import shards
from zsdist.roles.replay.role import Replay
from zsdist.roles.scheduler.role import Scheduler
from zsdist.roles.shapes import SHAPES
from zsdist.run.directory import RunDirectory
from zsdist.sim.env import CarNavigation
from zsdist.sim.scenes import families, scene
from zsdist.sim.scenes.scene import Scene
from zsdist.transport.base import Transport
from zsdist.transport.certificates import Identity
from zsdist.transport.zenoh import PORTS_TRIED, ZenohHub, ZenohTransport
from zsdist.types import Level, Parameters
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.vision.reading_cache import ReadingCache
from zsdist.vision.visual_act import VisualAct as PretrainedVisualAct
from zsdist.wire.messages import State

if TYPE_CHECKING:
    from zsdist.dqn.base import BaseDqnLearner

Watch = Callable[[Transport, float], None]  # called once a round with the runner's transport and the clock


@dataclass(frozen=True)
class RoleSpec:
    """One role of a program: its kind, which of them, and the epoch of this incarnation."""

    role: str
    id: str
    epoch: int

    @property
    def name(self) -> str:
        """Such as `actor-0`."""
        return f"{self.role}-{self.id}"


def supervisor(epochs: Sequence[int]) -> RoleSpec:
    """The runner itself, as one that speaks to the scheduler."""
    return RoleSpec("supervisor", "0", epochs[0])


def roles(config: Config, epochs: Sequence[int]) -> list[RoleSpec]:
    """All roles that do the run's work, in the order in which an inline run steps them."""
    return [RoleSpec(role, identifier, epoch) for (role, identifier), epoch in zip(_names(config), epochs, strict=True)]


def _names(config: Config) -> list[tuple[str, str]]:
    replays = [(shards.ROLE, str(index)) for index in range(config.replay.shards)]
    learners = [("learner", level.value) for level in Level]
    return [("scheduler", "0"), *replays, *learners, *(("actor", str(index)) for index in range(config.run.actors))]


def role_count(config: Config) -> int:
    """How many roles `roles` lists."""
    return len(_names(config))


def epoch_count(config: Config) -> int:
    """Epochs that a start takes: one for the runner, one for the hub, one a role, in this order."""
    return 2 + role_count(config)


class SceneSchedule:
    """Scenes by number, a pure function of the seed. Training and validation scenes have seeds of their own."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._sources = [_source(name) for name in config.scenes.train]

    def training(self, number: int) -> Scene:
        """Scene of training episode `number`: families in turn, scenes drawn from `train_scenes` of each."""
        source = self._sources[number % len(self._sources)]
        index = int(np.random.default_rng([self._config.seed, number, 2]).integers(self._config.scenes.train_scenes))
        return source("train", index)

    def validation(self, merge: int, index: int) -> Scene:
        """Validation scene `index` of a merge: the same for all its candidates, fresh for each merge."""
        source = self._sources[index % len(self._sources)]
        return source("validation", merge * 10_000 + index)


def _source(name: str) -> Callable[[str, int], Scene]:
    """Scenes of a family, or of a folder of scene files (which has no split: its files serve every purpose)."""
    if name in families.FAMILIES:
        return lru_cache(maxsize=64)(lambda split, index: families.draw(name, split, index))
    if not Path(name).is_dir():
        allowed = ", ".join(families.FAMILIES)
        raise SceneError(f"source of scenes {name!r} is no folder; allowed are {allowed} and a folder of scene files")
    scenes = scene.read_folder(Path(name))
    return lambda split, index: scenes[index % len(scenes)]


@dataclass(frozen=True)
class ActorParts:
    """What an actor is made of besides its agent."""

    make_env: Callable[[], CameraEnv]
    visual_act: VisionModel
    schedule: SceneSchedule


def simulation(config: Config) -> ActorParts:
    """The real thing: PyBullet cars, the camera, the shipped visual-act model."""
    return ActorParts(
        make_env=lambda: CarNavigation(config=config, images=False),
        visual_act=PretrainedVisualAct.load(config.vision, config.camera),
        schedule=SceneSchedule(config),
    )


def vision_here(config: Config) -> VisionIdentity:
    """By what cars of this configuration see on this machine; raises `WeightsError` as `VisionModel.load`."""
    return VisionIdentity.of(PretrainedVisualAct.load(config.vision, config.camera), config.vision.network)


def check_memory(config: Config) -> None:
    """Holds what the replay may grow to against its byte budget; raises `ConfigError` where it does not fit."""
    row = sum(row_bytes(shape.state_size, shape.actions) for shape in SHAPES.values())
    needed = config.replay.size_max * row
    if needed > config.replay.max_bytes:
        raise ConfigError(
            f"replay.size_max is {config.replay.size_max}: both levels would take {needed} bytes; "
            f"allowed by replay.max_bytes are {config.replay.max_bytes}"
        )


def check_certificates(config: Config) -> None:
    """Finds the certificates of all roles that live on this machine; raises `TransportError` as `Identity.load`."""
    if config.transport.tls is None:
        return
    here = [permissions.HUB, permissions.TRUSTED]
    if config.run.address is None:
        here += map(permissions.actor_name, range(config.run.actors))
    for name in here:
        Identity.load(config.transport.tls, name)


def check_shards(config: Config, states: Mapping[str, State]) -> None:
    """Holds that every shard of a checkpoint is gone on with; raises `ConfigError` where there are too few."""
    held = sum(name.partition("-")[0] == shards.ROLE for name in states)
    if held > config.replay.shards:
        raise ConfigError(
            f"replay.shards is {config.replay.shards} and the checkpoint holds {held}; allowed are {held} or more"
        )


def warm_up(config: Config) -> VisionIdentity:
    """Drives a car in this process: what is compiled or built at first use is then on disk for all.

    Returns:
        By what the car saw.

    Raises:
        ZsdistError: scenes or vision weights are not there, or do not fit the configuration.
    """
    for name in config.scenes.test:
        _source(name)
    parts = simulation(config)
    try_out(parts, config)
    return VisionIdentity.of(parts.visual_act, config.vision.network)


def try_out(parts: ActorParts, config: Config) -> None:
    """Drives a car for two steps: what is loaded or made at first use, which takes half a second, then is there."""
    car = ActorCar(parts.make_env(), config)
    car.begin(EpisodeTask(parts.schedule.training(1), 1, 1.0, True, (0,)), dict.fromkeys(Level, 0))
    q = q_functions({level: _untrained(config, level) for level in Level})
    perception = Perception(parts.visual_act, Grid.from_config(config.grid), config.vision.rays, None)
    for _ in range(2):
        car.advance(*perception.views([car]), q)
    car.env.close()


def _untrained(config: Config, level: Level) -> Parameters:
    shape, settings = SHAPES[level], config.high if level is Level.HIGH else config.low
    return network.initial_parameters(shape.state_size, shape.actions, settings.hidden, config.seed)


@dataclass(frozen=True)
class RunSpec:
    """What every role of a run shares, wherever it lives.

    Attributes:
        config: resolved.
        run: name on the key space.
        folder: the run directory.
        states: of the checkpoint that is gone on from, by role name; empty for a new run.
        vision: by what every car sees.
        make_parts: what actors are made of; tests put a kinematic car in the place of the simulation.
        start: a word of its own for each start of a run, which names the journals of its replays.
    """

    config: Config
    run: str
    folder: Path
    states: dict[str, State]
    vision: VisionIdentity
    make_parts: Callable[[Config], ActorParts] = simulation
    start: str = field(default_factory=lambda: uuid.uuid4().hex)

    def open_hub(self, endpoint: str | None = None) -> ZenohHub:
        """The router, at `endpoint`; None: at the configured one, or the next free port above it."""
        grants, tries = permissions.access_list(self.config.run.actors), PORTS_TRIED if endpoint is None else 1
        endpoint = endpoint or self.config.transport.endpoint
        return ZenohHub(endpoint, self._identity(permissions.HUB), grants, ports_tried=tries)

    def connect(self, role_spec: RoleSpec, endpoint: str) -> ZenohTransport:
        """A role's connection to the hub, with its certificate where the run has certificates."""
        return ZenohTransport(endpoint, self._identity(permissions.certificate_of(role_spec.role, role_spec.id)))

    def _identity(self, name: str) -> Identity | None:
        folder = self.config.transport.tls
        return None if folder is None else Identity.load(folder, name)

    def context(self, role_spec: RoleSpec, transport: Transport, wake: threading.Event) -> Context:
        """The context of one role."""
        return Context(self.config, self.run, role_spec.role, role_spec.id, role_spec.epoch, transport, wake)

    def build(
        self, role_spec: RoleSpec, transport: Transport, wake: threading.Event, parts: ActorParts | None = None
    ) -> Role:
        """One role, with its state restored where the run is gone on with.

        Args:
            role_spec: which.
            transport: its own.
            wake: set when mail comes for it.
            parts: what an actor is to be made of, where that has been made already.
        """
        context, config = self.context(role_spec, transport, wake), self.config
        match role_spec.role:
            case "scheduler":
                restored = self.states.get("scheduler")
                earlier_s = restored.meta["wall_s"] if restored else 0.0
                return Scheduler(context, RunDirectory(self.folder, self.vision, earlier_s), restored)
            case shards.ROLE:
                # A start of the run has journals of its own: those of an earlier one are older than its checkpoints.
                folder = self.folder / "journal" / f"{self.start}-{role_spec.id}"
                return Replay(context, SHAPES, folder, self.states.get(shards.state_name(int(role_spec.id))))
            case "learner":
                level = Level(role_spec.id)
                from zsdist.roles.learner import Learner  # the only role that needs torch: two seconds and 150 MB

                return Learner(context, level, make_learner(config, level), self.states.get(role_spec.name))
            case "actor":
                parts = parts or self.make_parts(config)
                seen = VisionIdentity.of(parts.visual_act, config.vision.network)
                if seen != self.vision:
                    raise WeightsError(
                        f"{role_spec.name} sees by {seen}; allowed is what the run sees by, {self.vision}"
                    )
                cars = [ActorCar(parts.make_env(), config) for _ in range(config.run.cars_per_actor)]
                return Actor(context, cars, self._perception(parts.visual_act), parts.schedule)
        raise ValueError(f"no role is called {role_spec.role!r}")

    def _perception(self, visual_act: VisionModel) -> Perception:
        size = self.config.vision.cache_bytes
        cache = ReadingCache(size, _seen_by(self.config, visual_act)) if size else None
        return Perception(visual_act, Grid.from_config(self.config.grid), self.config.vision.rays, cache)


def _seen_by(config: Config, visual_act: VisionModel) -> str:
    """All that a reading depends on besides scene and lattice state, as far as runs of a machine may differ in it."""
    settings = config.model_dump_json(include={"grid", "camera"})
    code = code_hash.sha256("zsdist.sim.env", "zsdist.vision.visual_act")
    libraries = (f"{name} {version(name)}" for name in ("numpy", "numba", "onnxruntime", "pybullet", "torch"))
    return "/".join((visual_act.encoder_sha256, visual_act.weights_sha256, settings, code, *libraries))


def make_learner(config: Config, level: Level) -> "BaseDqnLearner":
    """The DQN of one level, untrained; its initial weights follow from the run's seed."""
    from zsdist.dqn.fused import FusedDqnLearner

    shape, settings = SHAPES[level], config.high if level is Level.HIGH else config.low
    seed = 2 * config.seed + (level is Level.HIGH)
    return FusedDqnLearner(shape.state_size, shape.actions, settings, seed=seed, mirror=features.mirror(level))


def make_hub(spec: RunSpec, role_spec: RoleSpec, transport: Transport, wake: threading.Event, endpoint: str) -> Hub:
    """The hub's role, beside the router that its process holds."""
    return Hub(spec.context(role_spec, transport, wake), endpoint)


def supervision(
    spec: RunSpec, role_specs: Sequence[RoleSpec], *, interrupted: bool, restarts: Mapping[str, int] | None = None
) -> dict:
    """What a runner tells the scheduler, again and again.

    Args:
        spec: of the run.
        role_specs: all roles; the actors' newest epochs are told.
        interrupted: whether to stop early.
        restarts: processes replaced so far in this start, by kind of role.
    """
    return {
        "epochs": {role_spec.name: role_spec.epoch for role_spec in role_specs if role_spec.role == "actor"},
        "restarts": dict(restarts or {}),
        "interrupted": interrupted,
    }
