"""Every knob of a run, as frozen models with units in the names.

Precedence: the defaults here, then a YAML file (`--config`), then `--set key.path=value`. An unknown key or a value
outside its range raises `ConfigError` naming the key, the value and what is allowed.
"""

import difflib
import ipaddress
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from zsdist.common import strict_yaml
from zsdist.errors import ConfigError

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
Folder = Annotated[str, Field(min_length=1), AfterValidator(lambda path: str(Path(path).absolute()))]


def _lasting(name: str) -> str:
    """A path as one that holds from everywhere, since a run keeps it; a plain name, of something known, as it is."""
    return str(Path(name).absolute()) if "/" in name or name in (".", "..") else name


NameOrFolder = Annotated[str, Field(min_length=1), AfterValidator(_lasting)]
Sources = Annotated[tuple[NameOrFolder, ...], Field(min_length=1)]  # families, or folders of scene files


class Section(BaseModel):
    """A group of settings; frozen, strict about unknown keys, and without NaN and infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False)


class GridConfig(Section):
    """The planning grid (Eq. 7, Table 2), centred in the walled arena."""

    cells: Count = 32  # per side, low level
    blocks: Count = 4  # per side, high level
    cell_size_m: Positive = 0.625
    arena_m: Positive = 25.0


class ScenesConfig(Section):
    """Which scenes a run drives. Validation scenes come from the same families under seeds of their own."""

    train: Sources = ("singleton",)
    train_scenes: Count = 1000  # distinct scenes per family
    test: Sources = ("ood-start-goal", "ood-layout", "ood-clusters")


class CameraConfig(Section):
    """The on-board camera."""

    back_end: Literal["caster", "pybullet"] = "caster"
    size_px: Annotated[int, Field(ge=32, le=1024)] = 224
    field_of_view_deg: Annotated[float, Field(ge=30, le=120)] = 90.0
    range_m: Positive = 5.0
    height_m: Positive = 1.0
    forward_m: Annotated[float, Field(ge=-100, le=100)] = 1.0  # mount, ahead of the car's centre


class SimConfig(Section):
    """The car's world (Table 1)."""

    step_s: Positive = 0.05
    max_steps: Count = 500  # actions an episode (Table 2)
    success_radius_m: Positive = 0.60


class VisionConfig(Section):
    """Visual-act inference in the actor."""

    weights: NameOrFolder = "pretrained"  # shipped in the package, or a folder made by `zsdist.pretrain`
    encoder: NameOrFolder = "efficientnet-lite0"  # or a folder with a CLIP model, as open_clip or Hugging Face have it
    network: Literal["head", "student"] = "head"  # the head on the encoder's tokens, or the small network without it
    rays: Literal["all", "three", "none"] = "all"  # that reach the agent: three: one a direction; none: it sees nothing
    ray_quantile: Annotated[float, Field(gt=0, lt=1)] = 0.1
    cache_bytes: Annotated[int, Field(ge=0)] = 64 * 2**20  # of readings remembered in training, on a machine; 0: none


class RewardConfig(Section):
    """Terms of Eqs. (18)-(20), and what each level learns from."""

    goal: float = 1000.0
    collision: float = -200.0
    safe: float = 0.0
    step: float = 0.0
    literal: bool = False  # learn from the paper's sum instead of from progress


class AgentConfig(Section):
    """Algorithm 2: exploration, options, guide policies, shield."""

    epsilon_decay: Annotated[float, Field(gt=0, le=1)] = 0.995  # per finished episode (Table 2)
    epsilon_min: Share = 0.1
    guide_share: Share = 0.8  # of exploratory actions; the others are uniform
    option_max_steps: Count = 24
    shield_share: Share = 0.7  # of training episodes that are driven with the shield
    attraction: Positive = 1.0  # k_att of Eq. (14)
    repulsion: Positive = 1.0  # k_rep of Eq. (15)
    influence_m: Positive = 1.5  # d_o0 of Eq. (15)
    trail: NonNegative = 0.5  # repulsion from where the car has been
    high_policy: Literal["learned", "planner", "goal"] = "learned"  # goal: it is the only subgoal, a flat DQN
    low_policy: Literal["learned", "planner", "field"] = "learned"
    explored_share: Share = 0.5  # of a block's cells seen, from where it counts as explored


class LevelConfig(Section):
    """One DQN: its network and how it learns."""

    hidden: tuple[Count, ...] = (128, 128)
    learning_rate: Positive = 0.002  # Table 2
    discount: Share = 0.99
    reward_scale: Positive = 1.0
    double: bool = True
    huber: bool = True
    target_tau: Share = 0.01  # soft copy per update; 0: only the merge moves the target network
    max_gradient_norm: Positive = 10.0
    guide_margin: NonNegative = 0.8
    guide_margin_weight: NonNegative = 0.0
    updates_per_insert: Positive = 0.25  # an update every fourth step, as DQN had; held whatever the batch size
    min_size: Count = 128  # transitions from which learning starts


class HighConfig(LevelConfig):
    """The high level's own defaults. Table 2 has a discount of 0.99 for both levels (configs/paper.yaml)."""

    discount: Share = 0.95  # nearer to what it can foresee
    guide_margin_weight: NonNegative = 1.0
    min_size: Count = 16


class LowConfig(LevelConfig):
    """The low level's own defaults."""

    discount: Share = 0.95  # nearer to what it can foresee
    guide_margin_weight: NonNegative = 1.0


class ReplayConfig(Section):
    """Adaptive replay (Eqs. 21-23, Table 2)."""

    shards: Count = 1  # processes a level is divided among, each with the transitions of some of the actors
    n_step: Count = 1  # transitions of a trajectory whose rewards make up a return, at most
    prioritised: bool = False  # draw transitions by their last error instead of uniformly
    priority_exponent: Share = 0.6  # of the error; 0: uniformly
    importance_exponent: Share = 0.4  # of the weights that make good for drawing unequally; 1: wholly
    adaptive: bool = True
    size_initial: Count = 10_000
    size_min: Count = 1_000
    size_max: Count = 20_000
    batch_initial: Count = 128
    batch_min: Count = 16
    batch_max: Count = 256
    grow_rate: Annotated[float, Field(gt=0, lt=1)] = 0.9
    grow_threshold: Positive = 1.2
    shrink_rate: Annotated[float, Field(gt=0, lt=1)] = 0.9
    shrink_threshold: Positive = 1.0
    adjust_every_episodes: Count = 10
    average_episodes: Count = 50
    target_return: float = 710.0  # R_target: mean paper return of A* on 60 training scenes of `iid`
    max_bytes: Count = 256 * 2**20


class MergeConfig(Section):
    """The global policy's way into the target network."""

    every_episodes: Annotated[int, Field(ge=0)] = 100  # 0: never
    validation_scenes: Count = 20
    drive_steps: Count = 150  # actions after which a validation drive is a timeout; the best way takes about 30
    distil_updates: Count = 200
    drop_after_scenes: Count = 6  # a candidate clearly behind by then is not driven further


def is_loopback(endpoint: str) -> bool:
    """Whether nobody outside this machine reaches an endpoint, `PROTOCOL/HOST:PORT`."""
    host = endpoint.partition("/")[2].rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class TransportConfig(Section):
    """How messages travel."""

    kind: Literal["memory", "zenoh"] = "zenoh"
    endpoint: str = "tcp/127.0.0.1:7447"  # of the hub; with certificates tls/HOST:PORT, by default tls/127.0.0.1:7447
    tls: Folder | None = None  # with certificates (`python -m zsdist.certs`); None: nobody outside this machine
    mailbox_bytes: Count = 64 * 2**20
    window_frames: Count = 64  # unacknowledged frames an outbox may hold
    resend_after_s: Positive = 0.25
    give_up_after_s: Positive = 60.0

    @model_validator(mode="before")
    @classmethod
    def _short_forms(cls, value: Any) -> Any:
        if isinstance(value, str):
            return {"kind": value}
        if isinstance(value, dict) and value.get("tls") is not None:
            return {"endpoint": "tls/127.0.0.1:7447"} | value
        return value


class RunConfig(Section):
    """Length and shape of a run."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]+$")] = "default"
    episodes: Count = 150
    actors: Annotated[int, Field(ge=1, le=4096)] = 2
    cars_per_actor: Annotated[int, Field(ge=1, le=256)] = 4
    checkpoint_every_episodes: Count = 50
    cpus_per_role: Annotated[float, Field(gt=0)] = 0.1  # what each role asks Ray for
    standby: bool = True  # keep a process warm that takes over from one that dies
    address: str | None = None  # of a Ray cluster; None: start one on this machine
    final_evaluation_episodes: Annotated[int, Field(ge=0)] = 30


class Config(Section):
    """A whole run."""

    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    placement: Literal["inline", "ray"] = "ray"
    run: RunConfig = RunConfig()
    scenes: ScenesConfig = ScenesConfig()
    grid: GridConfig = GridConfig()
    sim: SimConfig = SimConfig()
    camera: CameraConfig = CameraConfig()
    vision: VisionConfig = VisionConfig()
    reward: RewardConfig = RewardConfig()
    agent: AgentConfig = AgentConfig()
    high: HighConfig = HighConfig()
    low: LowConfig = LowConfig()
    replay: ReplayConfig = ReplayConfig()
    merge: MergeConfig = MergeConfig()
    transport: TransportConfig = TransportConfig()

    @model_validator(mode="after")
    def _consistent(self) -> "Config":
        if self.transport.kind == "memory" and self.placement == "ray":
            raise ValueError("transport 'memory' lives in one process; with placement 'ray' use transport 'zenoh'")
        for low, value, high, name in (
            (self.replay.size_min, self.replay.size_initial, self.replay.size_max, "replay.size"),
            (self.replay.batch_min, self.replay.batch_initial, self.replay.batch_max, "replay.batch"),
        ):
            if not low <= value <= high:
                raise ValueError(f"{name}_initial is {value}; allowed is {name}_min to {name}_max, {low} to {high}")
        if self.replay.shards > self.run.actors:
            raise ValueError(
                f"replay.shards is {self.replay.shards}; allowed are at most as many as actors, {self.run.actors}"
            )
        endpoint = self.transport.endpoint
        if self.run.address is not None and is_loopback(endpoint):
            raise ValueError(
                f"transport.endpoint is {endpoint!r} with run.address {self.run.address!r}: roles on a cluster cannot "
                "reach a loopback endpoint; allowed is an address of this machine, such as tls/HOST:7447"
            )
        if self.run.address is not None and self.run.address.startswith("ray://"):
            raise ValueError(
                f"run.address is {self.run.address!r}: the run directory would lie here and the scheduler on another "
                "machine; allowed is 'auto' or HOST:PORT, given on a node of the cluster"
            )
        tls, found = self.transport.tls, f"transport.endpoint is {endpoint!r}"
        if tls is not None and not endpoint.startswith("tls/"):
            raise ValueError(f"{found} with transport.tls {tls!r}; allowed is tls/HOST:PORT")
        if tls is None and (endpoint.startswith("tls/") or not is_loopback(endpoint)):
            raise ValueError(
                f"{found} without certificates, so that whoever reaches it could do anything; allowed is a loopback "
                "address such as tcp/127.0.0.1:7447, or transport.tls with a folder made by python -m zsdist.certs"
            )
        if self.grid.cells % self.grid.blocks:
            raise ValueError(
                f"grid.cells is {self.grid.cells}; allowed are multiples of grid.blocks, {self.grid.blocks}"
            )
        return self


def load(path: str | Path | None = None, overrides: tuple[str, ...] = ()) -> Config:
    """The configuration of a YAML file (or the defaults) with `key.path=value` overrides applied.

    A file may name another, relative to itself, as its `base`: it then says only what differs from that one.

    Raises:
        ConfigError: the file cannot be read or is no YAML mapping; a key is unknown; a value is not allowed.
    """
    tree = {} if path is None else _read(Path(path))
    if base := tree.pop("base", None):
        below = _read(Path(path).parent / str(base))
        if "base" in below:
            raise ConfigError(f"configuration file {path}: its base {base} has a base too; allowed is one without")
        tree = _laid_over(below, tree)
    for override in overrides:
        _apply(tree, override)
    return parse(tree)


def parse(tree: dict[str, Any]) -> Config:
    """A checked `Config` from nested dictionaries; raises `ConfigError` in one line."""
    try:
        return Config.model_validate(tree)
    except ValidationError as error:
        raise ConfigError("; ".join(_explain(item) for item in error.errors())) from error


def dump(config: Config) -> str:
    """The configuration as YAML that `load` reads back to an equal one."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)


def known_keys(model: type[BaseModel] = Config, prefix: str = "") -> list[str]:
    """Every settable key path, depth first."""
    keys = []
    for name, field in model.model_fields.items():
        keys.append(prefix + name)
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            keys += known_keys(field.annotation, f"{prefix}{name}.")
    return keys


def _read(path: Path) -> dict[str, Any]:
    """The settings in a YAML file, unchecked."""
    try:
        tree = strict_yaml.load(path.read_text()) or {}
    except OSError as error:
        raise ConfigError(f"configuration file {path}: {error.strerror or error}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: no UTF-8, no such date or number
        raise ConfigError(f"configuration file {path} is not valid YAML: {' '.join(str(error).split())}") from error
    if not isinstance(tree, dict):
        raise ConfigError(f"configuration file {path} holds a {type(tree).__name__}; allowed is a mapping of settings")
    return tree


def _laid_over(below: Any, above: Any) -> Any:
    """One tree of settings over another: sections are merged, values replaced."""
    if not (isinstance(below, dict) and isinstance(above, dict)):
        return above
    return below | {key: _laid_over(below.get(key), value) for key, value in above.items()}


def _apply(tree: dict[str, Any], override: str) -> None:
    path, equals, text = override.partition("=")
    if not equals or not path:
        raise ConfigError(f"--set {override!r} is not of the form key.path=value")
    try:
        value = strict_yaml.load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ConfigError(f"--set {path}: value {text[:200]!r} is not valid YAML") from error
    *sections, leaf = path.split(".")
    node = tree
    for section in sections:
        node = node.setdefault(section, {})
        if not isinstance(node, dict):
            raise ConfigError(f"--set {path}: {section!r} is a value, not a section")
    node[leaf] = value


def _explain(item: dict[str, Any]) -> str:
    key = ".".join(str(part) for part in item["loc"])
    if item["type"] == "extra_forbidden":
        near = difflib.get_close_matches(key, known_keys(), n=1, cutoff=0.0)
        return f"unknown configuration key {key!r}; the nearest known one is {near[0]!r}"
    message = item["msg"].removeprefix("Value error, ")
    return f"{key} is {item['input']!r}: {message}" if key else message
