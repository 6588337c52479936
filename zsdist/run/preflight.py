"""Checks before a run writes or starts anything: memory, certificates, shards, scenes and vision weights."""

from collections.abc import Mapping

from zsdist.config import Config, leaves_of
from zsdist.errors import ConfigError
from zsdist.replay.buffer import row_bytes
from zsdist.roles import permissions
from zsdist.roles.replay import shards
from zsdist.run import placement, program
from zsdist.run.program import ActorParts, simulation
from zsdist.transport.certificates import Identity
from zsdist.types import Level
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire.messages import State

MAX_STATE_BYTES = 900 * 2**20  # zenoh drops a message of more than 1 GiB


def check_memory(config: Config) -> None:
    """Check the largest size of the replay against its byte budget.

    Raises:
        ConfigError: it does not fit.
    """
    from zsdist.roles.shapes import SHAPES

    row = sum(row_bytes(shape.state_size, shape.actions) for shape in SHAPES.values())
    needed = config.replay.size_max * row
    if needed > config.replay.max_bytes:
        raise ConfigError(
            f"replay.size_max is {config.replay.size_max}: both levels would take {needed} bytes; "
            f"allowed by replay.max_bytes are {config.replay.max_bytes}"
        )
    in_one = shards.ReplayShard.of(config, 0).part(config.replay.size_max) * row
    if in_one > MAX_STATE_BYTES:
        raise ConfigError(
            f"replay.size_max is {config.replay.size_max} with {config.replay.shards} replay.shards: a shard would "
            f"hold {in_one} bytes; allowed are {MAX_STATE_BYTES}, since its checkpoint is one message: use more shards"
        )


def check_used(settings: Config, overrides: tuple[str, ...]) -> None:
    """Check that overrides of `cluster` meet a run on a cluster; elsewhere they would do nothing.

    Raises:
        ConfigError: the run has no `run.address`.
    """
    for key in (key for text in overrides for key in leaves_of(text)):
        if key.startswith("cluster.") and settings.run.address is None:
            raise ConfigError(
                f"{key} was given, and the run is on this machine alone, where it does nothing; allowed with --address"
            )


def check_certificates(config: Config) -> None:
    """Load the certificates of all roles that live on this machine.

    Raises:
        TransportError: a certificate is missing or invalid, as `Identity.load` reports it.
    """
    if config.transport.tls is None:
        return
    here = {permissions.HUB: None}  # in order, each once
    for role_spec in program.roles(config, range(program.role_count(config))):
        if config.run.address is None or placement.lives_here(role_spec, config):
            here[permissions.certificate_of(role_spec.role, role_spec.id)] = None
    for name in here:
        Identity.load(config.transport.tls, name)


def check_recorded(config: Config) -> None:
    """Check the recorded sets from which a new run starts.

    Raises:
        DataError: one is not there, or does not fit the configuration.
    """
    from zsdist.roles.replay import start

    start.recorded_sets(config)


def check_shards(config: Config, states: Mapping[str, State]) -> None:
    """Check that a run has at least as many shards as the checkpoint from which it resumes.

    Raises:
        ConfigError: it has fewer.
    """
    held = sum(map(shards.is_state_name, states))
    if held > config.replay.shards:
        raise ConfigError(
            f"replay.shards is {config.replay.shards} and the checkpoint holds {held}; allowed are {held} or more"
        )


def warm_up(config: Config) -> VisionIdentity:
    """Drive a car in this process: code that is compiled at first use is then on disk for all processes.

    Returns:
        The vision model that the car used.

    Raises:
        ZsdistError: scenes or vision weights are missing, or do not fit the configuration.
    """
    from zsdist.run.scene_schedule import scene_source

    for name in config.scenes.test:
        scene_source(name)
    parts = simulation(config)
    try_out(parts, config)
    return VisionIdentity.of(parts.visual_act, config.vision.network)


def try_out(parts: ActorParts, config: Config) -> None:
    """Drive a car for two steps, which loads everything that is loaded at first use (half a second)."""
    from zsdist.agent.hierarchy import q_functions
    from zsdist.driving.actor_car import ActorCar, EpisodeTask
    from zsdist.driving.perception import Perception
    from zsdist.planning.grid import Grid
    from zsdist.roles.shapes import initial_weights

    car = ActorCar(parts.make_env(), config)
    car.begin(EpisodeTask(parts.schedule.training(1), 1, 1.0, True, (0,)), dict.fromkeys(Level, 0))
    q = q_functions({level: initial_weights(config, level) for level in Level})
    perception = Perception(parts.visual_act, Grid.from_config(config.grid), config.vision.rays, None)
    for _ in range(2):
        (view,) = perception.views([car])
        car.advance(view, q)
    car.env.close()
