"""Composition root: the roles of a run and the construction of each. No role knows where it runs."""

import threading
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zsdist.common import background, code_hash
from zsdist.config import Config
from zsdist.errors import WeightsError
from zsdist.roles import permissions
from zsdist.roles.base import Context, Role
from zsdist.roles.replay import shards
from zsdist.transport import certificates
from zsdist.transport.access import Grant
from zsdist.transport.base import Transport
from zsdist.transport.certificates import Identity
from zsdist.transport.zenoh import ZenohHub, ZenohTransport
from zsdist.types import Level
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire.messages import State

if TYPE_CHECKING:  # each role imports what it needs when it is built: a car takes a second and 60 MB
    from zsdist.dqn.base import BaseDqnLearner
    from zsdist.driving.actor_car import CameraEnv
    from zsdist.driving.perception import Perception, VisionModel
    from zsdist.roles.hub import Hub
    from zsdist.run.directory import RunDirectory
    from zsdist.run.scene_schedule import SceneSchedule

PORT_FREE_WITHIN_S = 10.0  # time for which a new hub waits for the port of one that was killed
HUB_BACK_WITHIN_S = 60.0  # time for which a new role looks for the hub, which may be about to be replaced
Watch = Callable[[Transport, float], None]  # called once a round with the runner's transport and the clock


@dataclass(frozen=True)
class RoleSpec:
    """One role of a program.

    Attributes:
        role: kind of role.
        id: number or name that tells roles of one kind apart.
        epoch: epoch of this incarnation.
    """

    role: str
    id: str
    epoch: int

    @property
    def name(self) -> str:
        """Name of the role, such as `actor-0`."""
        return f"{self.role}-{self.id}"

    def reason(self, error: Exception) -> str:
        """Return the reason why the role cannot go on, in one line."""
        return f"{self.name}: {error}"


def supervisor(epochs: Sequence[int]) -> RoleSpec:
    """Return the runner itself, as a role that sends orders to the scheduler."""
    return RoleSpec("supervisor", "0", epochs[0])


def roles(config: Config, epochs: Sequence[int]) -> list[RoleSpec]:
    """Return all roles that do the work of a run, in the order in which an inline run steps them."""
    return [RoleSpec(role, identifier, epoch) for (role, identifier), epoch in zip(_names(config), epochs, strict=True)]


def _names(config: Config) -> list[tuple[str, str]]:
    replays = [(shards.ROLE, str(index)) for index in range(config.replay.shards)]
    learners = [("learner", level.value) for level in Level]
    return [("scheduler", "0"), *replays, *learners, *(("actor", str(index)) for index in range(config.run.actors))]


def role_count(config: Config) -> int:
    """Return the number of roles that `roles` lists."""
    return len(_names(config))


def reporting(config: Config) -> list[str]:
    """Return the names of all roles that report once the run has started; where Ray runs them, of the hub too."""
    hub = ["hub-0"] if config.placement == "ray" else []
    return hub + [f"{role}-{identifier}" for role, identifier in _names(config)]


def epoch_count(config: Config) -> int:
    """Return the number of epochs that a start takes: for the runner, the hub and each role, in this order."""
    return 2 + role_count(config)


@dataclass(frozen=True)
class ActorParts:
    """Parts that an actor is made of besides its agents.

    Attributes:
        make_env: factory of the environment of one car.
        visual_act: vision model of all cars.
        schedule: scenes by number.
    """

    make_env: "Callable[[], CameraEnv]"
    visual_act: "VisionModel"
    schedule: "SceneSchedule"


def simulation(config: Config) -> ActorParts:
    """Return the parts of a simulated actor: PyBullet cars, the camera, the pretrained vision model."""
    from zsdist.run.scene_schedule import SceneSchedule
    from zsdist.sim.env import CarNavigation
    from zsdist.vision.visual_act import VisualAct

    return ActorParts(
        make_env=lambda: CarNavigation(config=config, images=False),
        visual_act=VisualAct.load(config.vision, config.camera),
        schedule=SceneSchedule(config),
    )


def vision_here(config: Config) -> VisionIdentity:
    """Return the vision model that this configuration loads on this machine.

    Raises:
        WeightsError: as `VisualAct.load` raises it.
    """
    from zsdist.vision.visual_act import VisualAct

    return VisionIdentity.of(VisualAct.load(config.vision, config.camera), config.vision.network)


@dataclass(frozen=True)
class RunSpec:
    """Specification of a run: all that its roles share, in any process.

    Attributes:
        config: resolved configuration.
        run: name of the run on the key space.
        folder: run directory.
        states: states of the checkpoint from which the run resumes, by role name; empty for a new run.
        vision: vision model that every car uses.
        make_parts: factory of the parts of an actor; tests put a kinematic car in the place of the simulation.
        start: unique word for this start of the run, part of the names of its journals; a start that goes on with the
            journals of one whose launcher was killed has the same.
        launch: epoch of the runner; 0: none was issued yet.
        profile: whether to write where each role's time goes (`zsdist.run.profiling`).
        make_dqn: factory of the DQN of a level, from configuration and level; another algorithm goes in here.
    """

    config: Config
    run: str
    folder: Path
    states: dict[str, State]
    vision: VisionIdentity
    make_parts: Callable[[Config], ActorParts] = simulation
    start: str = field(default_factory=lambda: uuid.uuid4().hex)
    launch: int = 0
    profile: bool = False
    make_dqn: "Callable[[Config, Level], BaseDqnLearner]" = field(default_factory=lambda: make_learner)

    def open_hub(self, endpoint: str | None = None) -> ZenohHub:
        """Open the router at the `endpoint` of its predecessor; None: at the configured one, or the next free port."""
        identity, grants = self._identity(permissions.HUB), self._grants()
        if endpoint is None:
            return ZenohHub(self.config.transport.endpoint, identity, grants)
        is_root = bool(self.config.cluster.hubs)
        return ZenohHub(endpoint, identity, grants, ports_tried=1, patience_s=PORT_FREE_WITHIN_S, succeeds_root=is_root)

    def open_branch(self, endpoint: str, root: str) -> ZenohHub:
        """Open the router of a rack or a site at `endpoint`, which connects to the run's own at `root`."""
        identity = self._identity(permissions.HUB)
        return ZenohHub(endpoint, identity, self._grants(), ports_tried=1, patience_s=PORT_FREE_WITHIN_S, root=root)

    def _grants(self) -> list[Grant]:
        config, tls = self.config, self.config.transport.tls
        certified = () if tls is None else certificates.names(tls)  # not all possible names: each takes 0.2 MiB
        hubs = 1 + len(config.cluster.hubs)
        return permissions.access_list(config.run.actors, certified, shards=config.replay.shards, hubs=hubs)

    def connect(self, role_spec: RoleSpec, endpoint: str, others: Sequence[str] = ()) -> ZenohTransport:
        """Return a role's connection to the hub, with its certificate where the run has certificates.

        Args:
            role_spec: the role.
            endpoint: endpoint of its hub.
            others: endpoints of hubs that it uses while that one does not answer.
        """
        identity = self._identity(permissions.certificate_of(role_spec.role, role_spec.id))
        return ZenohTransport(endpoint, identity, connect_timeout_s=HUB_BACK_WITHIN_S, others=others)

    def _identity(self, name: str) -> Identity | None:
        folder = self.config.transport.tls
        return None if folder is None else Identity.load(folder, name)

    def open_directory(self) -> "RunDirectory":
        """Open the files of the run, as the scheduler writes them."""
        from zsdist.run.directory import RunDirectory

        files = RunDirectory(self.folder, self.vision, self.config.run.checkpoints_kept)
        files.show_settings(self.config)
        return files

    def context(self, role_spec: RoleSpec, transport: Transport, wake: threading.Event) -> Context:
        """Return the context of one role."""
        own_thread = self.config.transport.kind != "memory"  # there the clock is virtual, and a run repeats bit for bit
        place = background.thread(role_spec.name) if own_thread else background.at_once
        who = (self.run, role_spec.role, role_spec.id, role_spec.epoch)
        return Context(self.config, *who, transport, wake, place, self.launch)

    def build(
        self,
        role_spec: RoleSpec,
        transport: Transport,
        wake: threading.Event,
        parts: ActorParts | None = None,
        run_directory: "RunDirectory | None" = None,
    ) -> Role:
        """Return one role; its state is restored where the run resumes from a checkpoint.

        Args:
            role_spec: role to build.
            transport: transport of the role.
            wake: event that is set when a message arrives for the role.
            parts: parts of an actor that exist already; None: they are made here.
            run_directory: files of the scheduler that are open already; None: they are opened here.

        Raises:
            WeightsError: an actor has loaded another vision model than the run.
        """
        context, config = self.context(role_spec, transport, wake), self.config
        match role_spec.role:
            case "scheduler":
                from zsdist.roles.scheduler.role import Scheduler
                from zsdist.run import journals

                log, ledger = run_directory or self.open_directory(), journals.ledger(self.folder, self.start)
                return Scheduler(context, log, ledger, self.states.get(role_spec.role))
            case shards.ROLE:
                from zsdist.roles.replay import start
                from zsdist.roles.replay.role import Replay
                from zsdist.roles.shapes import SHAPES
                from zsdist.run import journals

                index = int(role_spec.id)
                has_predecessor = self.launch > 0 and role_spec.epoch >= self.launch + epoch_count(config)
                where = (config, self.run, self.folder, self.start, index)
                own = journals.begin(*where, has_predecessor=has_predecessor)
                recorded = [] if self.states else start.recorded_sets(config)
                return Replay(context, SHAPES, own, self.states.get(shards.state_name(index)), recorded)
            case "learner":
                level = Level(role_spec.id)
                from zsdist.roles.learner import Learner  # the only role that needs torch: two seconds and 150 MB
                from zsdist.run import learners

                dqn, restored = self.make_dqn(config, level), self.states.get(role_spec.name)
                if config.placement != "ray":  # in one process it has neither a predecessor nor a successor
                    return Learner(context, level, dqn, restored, refused=self.folder / "nan")
                return learners.resumed(context, level, dqn, restored, folder=self.folder, start=self.start)
            case "actor":
                from zsdist.driving.actor_car import ActorCar
                from zsdist.roles.actor import Actor

                parts = parts or self.make_parts(config)
                loaded = VisionIdentity.of(parts.visual_act, config.vision.network)
                if loaded != self.vision:
                    raise WeightsError(
                        f"{role_spec.name} has loaded vision model {loaded}; allowed is that of the run, {self.vision}"
                    )
                cars = [ActorCar(parts.make_env(), config) for _ in range(config.run.cars_per_actor)]
                return Actor(context, cars, self._perception(parts.visual_act), parts.schedule)
        raise ValueError(f"no role is called {role_spec.role!r}")

    def _perception(self, visual_act: "VisionModel") -> "Perception":
        from zsdist.driving.perception import Perception
        from zsdist.planning.grid import Grid
        from zsdist.vision.reading_cache import ReadingCache

        size = self.config.vision.cache_bytes
        cache = ReadingCache(size, reading_fingerprint(self.config, visual_act)) if size else None
        return Perception(visual_act, Grid.from_config(self.config.grid), self.config.vision.rays, cache)


def reading_fingerprint(config: Config, visual_act: "VisionModel") -> str:
    """Return a text that names all that a reading depends on, except the scene and the lattice state.

    Runs on one machine share a cache of readings; two runs with different fingerprints share no reading in it.
    """
    settings = config.model_dump_json(include={"grid", "camera"})
    settings += "" if config.vision.device == "cpu" else config.vision.device  # the last bits of a reading differ
    code = code_hash.sha256("zsdist.sim.env", "zsdist.vision.visual_act")
    libraries = (f"{name} {version(name)}" for name in ("numpy", "numba", "onnxruntime", "pybullet", "torch"))
    return "/".join((visual_act.encoder_sha256, visual_act.weights_sha256, settings, code, *libraries))


def make_learner(config: Config, level: Level) -> "BaseDqnLearner":
    """Return the DQN of one level, untrained; its initial weights follow from the run's seed."""
    from zsdist.agent import features
    from zsdist.dqn.fused import FusedDqnLearner
    from zsdist.roles.shapes import SHAPES, learner_seed, level_settings

    shape, settings, seed = SHAPES[level], level_settings(config, level), learner_seed(config, level)
    return FusedDqnLearner(shape.state_size, shape.actions, settings, seed=seed, mirror=features.mirror(level))


def make_hub(spec: RunSpec, role_spec: RoleSpec, transport: Transport, wake: threading.Event, endpoint: str) -> "Hub":
    """Return the role of the hub, for the process that holds the router."""
    from zsdist.roles.hub import Hub

    return Hub(spec.context(role_spec, transport, wake), endpoint)


def supervision(
    role_specs: Sequence[RoleSpec],
    *,
    interrupted: bool,
    restarts: Mapping[str, int] | None = None,
    until: int | None = None,
    guests: Mapping[str, int] | None = None,
    left: Mapping[str, int] | None = None,
) -> dict[str, Any]:
    """Return the content of the orders that a runner repeats to the scheduler (`schemas.Supervision`).

    Args:
        role_specs: roles that are there; the orders name the actors' epochs.
        interrupted: whether to stop early.
        restarts: number of processes replaced so far in this start, by kind of role.
        until: number of finished episodes at which all roles close; None: the run's.
        guests: epochs of the actors that have joined from elsewhere.
        left: last epochs of actors that were there and are not.
    """
    own = {role_spec.name: role_spec.epoch for role_spec in role_specs if role_spec.role == "actor"}
    return {
        "epochs": {**own, **(guests or {})},
        "left": dict(left or {}),
        "restarts": dict(restarts or {}),
        "interrupted": interrupted,
        "until": until,
    }
