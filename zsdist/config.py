"""Settings of a run: one frozen model per section, with a default and a range for every key and units in the names.

A value comes from the defaults below, from a YAML file (`--config`) and from `--set key.path=value`; the later of these
overrides the earlier. An unknown key or a value out of range raises `ConfigError`, which names the key, the value and
what is allowed. `Table n`, `Eq. (n)` and `Algorithm n` refer to the paper.
"""

import difflib
import ipaddress
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, Field, ValidationError, model_validator

from zsdist.common import places, presets, ranges, values
from zsdist.common import setting_trees as trees
from zsdist.common.placement_settings import LAUNCHER, ClusterConfig
from zsdist.common.places import Place
from zsdist.common.section import Section
from zsdist.errors import ConfigError

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
Text = Annotated[str, Field(min_length=1)]
Folder = Annotated[Text, Place()]
Source = Annotated[Text, Place(places.FAMILIES)]  # scene family, or folder of scene files
Sources = Annotated[tuple[Source, ...], Field(min_length=1)]
Weights = Annotated[Text, Place((places.WEIGHTS,))]
Encoder = Annotated[Text, Place((places.ENCODER,))]


class GridConfig(Section):
    """Planning grid (Eq. 7, Table 2), centred in the walled arena."""

    cells: Count = 32  # cells per side, the grid of the low level; a multiple of `blocks`
    blocks: Count = 4  # blocks of cells per side, the grid of the high level
    cell_size_m: ranges.Metres = 0.625  # side of a cell
    arena_m: ranges.Metres = 25.0  # side of the square arena


class ScenesConfig(Section):
    """Scenes of a run. Validation scenes come from the training families, drawn with other seeds."""

    train: Sources = ("singleton",)  # families, or folders of scene files, to train on
    train_scenes: Annotated[int, Field(ge=1, le=1_000_000)] = 1000  # distinct training scenes per family
    test: Sources = ("ood-start-goal", "ood-layout", "ood-clusters")  # evaluated after training


class CameraConfig(Section):
    """On-board camera."""

    back_end: Literal["caster", "pybullet"] = "caster"  # renderer: our own ray caster, or PyBullet's
    size_px: Annotated[int, Field(ge=32, le=1024)] = 224  # side of the square picture
    field_of_view_deg: Annotated[float, Field(ge=30, le=120)] = 90.0  # horizontal and vertical angle
    range_m: ranges.Metres = 5.0  # range of vision; a ray that meets nothing nearer is free
    height_m: ranges.Metres = 1.0  # height of the camera above the ground
    forward_m: Annotated[float, Field(ge=-100, le=100)] = 1.0  # distance of the camera ahead of the car's centre


class SimConfig(Section):
    """Simulation (Table 1)."""

    step_s: ranges.PhysicsStep = 0.05  # simulated time per physics step
    max_steps: ranges.Steps = 500  # actions per episode; then it ends as a timeout (Table 2)
    success_radius_m: ranges.Metres = 0.60  # distance to the goal at which an episode succeeds


class VisionConfig(Section):
    """Visual-act model: what the agent perceives from a picture."""

    weights: Weights = places.WEIGHTS  # the weights in the package, or a folder made by `zsdist.pretrain`
    encoder: Encoder = places.ENCODER  # or a folder with a CLIP model of open_clip or Hugging Face
    network: Literal["head", "student", "compact"] = "head"  # head on the encoder's tokens; the others: no encoder
    rays: Literal["all", "three", "none"] = "all"  # rays the agent gets; three: one per direction; none: no vision
    ray_quantile: Annotated[float, Field(gt=0, lt=1)] = 0.1  # quantile of the prediction used as a ray's distance
    cache_bytes: Annotated[int, Field(ge=0)] = 64 * 2**20  # size of the cache of readings, per machine; 0: no cache
    device: Literal["cpu", "gpu", "auto"] = "cpu"  # auto: a GPU where the process sees one and onnxruntime can use it


class RewardConfig(Section):
    """Reward terms of Eqs. (18)-(20), and which reward the levels learn from."""

    goal: ranges.Reward = 1000.0  # reward for reaching the goal
    collision: ranges.Reward = -200.0  # reward for hitting an obstacle
    safe: ranges.Reward = 0.0  # R_safe of the obstacle term, for an action without collision
    step: ranges.Reward = 0.0  # R_step of the goal term, for an action that does not reach the goal
    literal: bool = False  # learn from the paper's sum of the terms; false: from progress towards subgoal and goal


class AgentConfig(Section):
    """Hierarchical agent (Algorithm 2): exploration, options, guide policies and shield."""

    epsilon_decay: Annotated[float, Field(gt=0, le=1)] = 0.995  # factor per finished episode (Table 2)
    epsilon_min: Share = 0.1  # lower bound of epsilon (Table 2)
    guide_share: Share = 0.8  # share of exploratory actions that follow the guide policy; the others are uniform
    option_max_steps: Count = 24  # actions after which the high level chooses a new subgoal
    shield_share: Share = 0.7  # share of training episodes in which the shield masks unsafe actions
    attraction: ranges.Factor = 1.0  # k_att of Eq. (14)
    repulsion: ranges.Factor = 1.0  # k_rep of Eq. (15)
    influence_m: ranges.Metres = 1.5  # d_o0 of Eq. (15), distance from which obstacles repel
    trail: ranges.Weight = 0.5  # weight of the repulsion from positions that the car has visited
    high_policy: Literal["learned", "planner", "goal"] = "learned"  # planner: over blocks; goal: flat DQN
    low_policy: Literal["learned", "planner", "field"] = "learned"  # planner: shortest path; field: potential field
    explored_share: Share = 0.5  # seen share of a block's cells from which the block counts as explored


class LevelConfig(Section):
    """DQN of one level: its network and its learning."""

    hidden: ranges.Widths = (128, 128)  # widths of the hidden layers
    learning_rate: ranges.LearningRate = 0.002  # Table 2
    discount: Share = 0.99  # factor on values of the next state (Table 2)
    reward_scale: ranges.Factor = 1.0  # factor on rewards before learning
    double: bool = True  # double DQN; false: the target network chooses the next action too
    huber: bool = True  # Huber loss; false: squared error
    target_tau: Share = 0.01  # share of the soft target update, per update; 0: only a merge changes the target network
    max_gradient_norm: Positive = 10.0  # norm to which gradients are clipped
    guide_margin: ranges.Weight = 0.8  # value by which the guide's action should exceed the others
    guide_margin_weight: ranges.Weight = 0.0  # weight of the margin loss; 0: it is not used
    updates_per_insert: ranges.Ratio = (
        0.25  # updates per new transition, for any batch size; DQN updates every fourth step
    )
    min_size: Count = 128  # stored transitions from which learning starts


class HighConfig(LevelConfig):
    """Defaults that differ for the high level. Table 2 has a discount of 0.99 for both levels (configs/paper.yaml)."""

    discount: Share = 0.95  # a horizon nearer to what the level can foresee
    guide_margin_weight: ranges.Weight = 1.0
    min_size: Count = 16


class LowConfig(LevelConfig):
    """Defaults that differ for the low level."""

    discount: Share = 0.95  # as for the high level
    guide_margin_weight: ranges.Weight = 1.0


class ReplayConfig(Section):
    """Replay buffers, whose sizes adapt to the return (Eqs. 21-23, Table 2)."""

    shards: Count = 1  # replay processes, each with the transitions of some of the actors; at most one per actor
    n_step: Count = 1  # most rewards of a trajectory that are summed up in an n-step return
    prioritised: bool = False  # sample by the last temporal-difference error instead of uniformly
    priority_exponent: Share = 0.6  # exponent of the error; 0: uniform sampling
    importance_exponent: Share = 0.4  # exponent of importance weights; 1: no sampling bias is left
    adaptive: bool = True  # adapt the sizes of buffer and batch; false: keep the initial ones
    size_initial: Count = 10_000  # transitions in the buffer of a level
    size_min: Count = 1_000  # least transitions in the buffer of a level
    size_max: Count = 20_000  # most transitions in the buffer of a level
    batch_initial: Count = 128  # transitions in a batch
    batch_min: Count = 16  # least transitions in a batch
    batch_max: ranges.BatchSize = 256  # most transitions in a batch
    grow_rate: Annotated[float, Field(gt=0, lt=1)] = 0.9  # an adjustment grows a size to at most size / grow_rate
    grow_threshold: Positive = 1.2  # wanted / current size above which it grows
    shrink_rate: Annotated[float, Field(gt=0, lt=1)] = 0.9  # and shrinks it to at least size * shrink_rate
    shrink_threshold: Positive = 1.0  # wanted / current size below which it shrinks
    adjust_every_episodes: Count = 10  # finished episodes between adjustments of the sizes
    average_episodes: Count = 50  # latest episodes whose mean return decides
    target_return: float = 710.0  # R_target: mean paper return of A* on 60 training scenes of `iid`
    fsync_ms: Annotated[int, Field(ge=0)] | None = None  # time between syncs of journals; None: they are never synced
    journals: tuple[Folder, ...] = ()  # folders of the shards' journals, given in turn; none: the run directory's
    start_from: tuple[Folder, ...] = ()  # sets of `zsdist record` whose transitions a new run has from the beginning
    max_bytes: Count = 256 * 2**20  # limit for the buffers of both levels; a run that needs more is refused


class MergeConfig(Section):
    """Merge of the global policy: the best of several candidates on validation scenes becomes the target network."""

    every_episodes: Annotated[int, Field(ge=0)] = 100  # finished episodes between merges; 0: no merge
    validation_scenes: ranges.Drives = 20  # scenes that every candidate drives
    drive_steps: Count = 150  # actions after which a validation drive is a timeout; the shortest path takes about 30
    distil_updates: Count = 200  # updates towards the guide's actions that make the distilled candidate
    drop_after_scenes: Count = 6  # scenes after which a candidate that is clearly behind is dropped
    share: Annotated[float, Field(gt=0, le=1)] = 0.5  # most of the cars' actions for such drives beside training


SHORT_FORMS = {"transport": "transport.kind"}  # settings that the name of their section alone stands for
ONE_PROCESS = ("placement=inline", "transport.kind=memory", "run.address=null")  # `launch --single-process`


def is_loopback(endpoint: str) -> bool:
    """Return whether an endpoint, `PROTOCOL/HOST:PORT`, can be reached from this machine only."""
    host = endpoint.partition("/")[2].rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class TransportConfig(Section):
    """Transport of messages between roles. The kind alone may be written: `transport: memory`."""

    kind: Literal["memory", "zenoh"] = "zenoh"  # memory: within one process
    endpoint: str = "tcp/127.0.0.1:7447"  # endpoint of the hub; with `tls` tls/HOST:PORT, default tls/127.0.0.1:7447
    tls: Folder | None = None  # folder made by `python -m zsdist.certs`; None: reachable from this machine only
    mailbox_bytes: Count = 32 * 2**20  # of received messages that wait or are in process; others are sent again
    window_frames: ranges.Window = 64  # unacknowledged frames per stream
    resend_after_s: Positive = 0.25  # age at which an unacknowledged frame is sent again
    give_up_after_s: Positive = 60.0  # time without progress at a live receiver after which the run fails

    @model_validator(mode="before")
    @classmethod
    def _short_forms(cls, value: Any) -> Any:
        if isinstance(value, str) and value:
            return {"kind": value}
        if isinstance(value, dict) and values.typed(str | None, value.get("tls")) is not None:
            return {"endpoint": "tls/127.0.0.1:7447"} | value
        return value


class RunConfig(Section):
    """Length and size of a run."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]+$")] = "default"  # first part of the run directory's name
    episodes: Annotated[int, Field(ge=1, lt=2**31)] = 150  # training episodes of all actors together
    actors: Annotated[int, Field(ge=1, le=4096)] = 2  # actor processes
    cars_per_actor: Annotated[int, Field(ge=1, le=256)] = 4  # cars that an actor drives at the same time
    checkpoint_every_episodes: Count = 50  # finished episodes between checkpoints
    checkpoint_every_s: Annotated[float, Field(ge=1, le=1e9)] = 60.0  # seconds until one is made in any case
    cpus_per_role: Annotated[float, Field(gt=0)] = 0.1  # CPUs that each role requests from Ray
    checkpoints_kept: Annotated[int, Field(ge=1, le=10_000)] = 3  # newest ones that stay, besides the best one
    standby: bool = True  # keep a spare process ready that takes over from one that dies
    address: str | None = None  # address of a Ray cluster; None: start Ray on this machine
    final_evaluation_episodes: Annotated[int, Field(ge=0)] = 30  # per policy, after training; 0: no evaluation


class Config(Section):
    """Settings of a whole run."""

    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0  # seed of scenes, networks and exploration
    placement: Literal["inline", "ray"] = "ray"  # inline: all roles in one process
    run: RunConfig = RunConfig()
    cluster: ClusterConfig = ClusterConfig()
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
            raise ValueError("transport 'memory' works within one process; with placement 'ray' use transport 'zenoh'")
        for low, value, high, name in (
            (self.replay.size_min, self.replay.size_initial, self.replay.size_max, "replay.size"),
            (self.replay.batch_min, self.replay.batch_initial, self.replay.batch_max, "replay.batch"),
        ):
            if not low <= value <= high:
                raise ValueError(f"{name}_initial is {value}; allowed is {name}_min to {name}_max, {low} to {high}")
        if self.replay.shards > self.run.actors:
            raise ValueError(f"replay.shards is {self.replay.shards}; allowed is at most run.actors, {self.run.actors}")
        if self.cluster.replay.node != LAUNCHER and not self.replay.journals:
            raise ValueError(
                f"cluster.replay.node is {self.cluster.replay.node!r} without replay.journals: the run directory may "
                "not be there; allowed is a folder on the disk of those machines, as replay.journals=/var/lib/zsdist"
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
                f"{found} without certificates, so anyone who reaches it could control the run; allowed is a loopback "
                "address such as tcp/127.0.0.1:7447, or transport.tls with a folder made by python -m zsdist.certs"
            )
        if self.grid.cells % self.grid.blocks:
            raise ValueError(
                f"grid.cells is {self.grid.cells}; allowed are multiples of grid.blocks, {self.grid.blocks}"
            )
        return self


Notify = Callable[[str], None]  # shows one line to the user


def load(path: str | Path | None = None, overrides: tuple[str, ...] = (), notify: Notify | None = None) -> Config:
    """Return the configuration of a YAML file, or the defaults, with `key.path=value` overrides applied.

    A file may name a preset as its `base`, or another file by a path relative to itself. It then holds only what
    differs from the base, and the base may not have a base itself. The type of a setting decides what its text means
    (`common.values`).

    Args:
        path: YAML file, or the name of a preset as a text; None: the defaults.
        overrides: settings to change; of two values of one setting the later counts.
        notify: called where a given name is a built-in one and also a file or folder here.

    Raises:
        ConfigError: the file cannot be read or is no YAML mapping; a key is unknown; a value is not allowed.
    """
    preset = presets.find(path) if isinstance(path, str) else None
    if preset is not None and notify is not None and (line := presets.find_clash(str(path))):
        notify(line)
    file = preset or (None if path is None else Path(path))
    tree = _changed({} if file is None else trees.read(file), overrides)
    _note_clashes(tree, notify)
    return parse(tree)


def load_kept(path: Path, overrides: tuple[str, ...] = (), notify: Notify | None = None) -> Config:
    """Return the configuration that a run keeps, with overrides applied, wherever this process runs.

    Raises:
        ConfigError: as `load`; or a path in it is relative, as earlier versions kept some.
    """
    changes = _changed({}, overrides)
    _note_clashes(changes, notify)
    tree, given = _changed(trees.read(path), overrides), trees.flat(changes)
    for key, place, text in trees.find_places(tree, Config):
        if key not in given and text not in place.names and not Path(text).is_absolute():
            raise ConfigError(
                f"{path} has {key} {text!r}, a relative path that an earlier version kept; "
                f"say where it is now with --set {key}=PATH"
            )
    return parse(tree)


def _changed(tree: dict[str, Any], overrides: tuple[str, ...]) -> dict[str, Any]:
    for override in overrides:
        trees.apply(tree, override, Config, SHORT_FORMS)
    return tree


def _note_clashes(tree: dict[str, Any], notify: Notify | None) -> None:
    for key, place, text in trees.find_places(tree, Config):
        if notify is not None and (line := places.find_clash(key, text, place.names)):
            notify(line)


def leaves_of(override: str) -> dict[str, Any]:
    """Return the values in an override by the paths of their settings; a section has several."""
    return trees.flat(_changed({}, (override,)))


def parse(tree: dict[str, Any]) -> Config:
    """Return the checked configuration in nested dictionaries; raise `ConfigError` with all problems in one line."""
    try:
        return Config.model_validate(tree)
    except ValidationError as error:
        raise ConfigError("; ".join(_explain(item) for item in error.errors())) from error


def dump(config: Config) -> str:
    """Return the configuration as YAML, from which `load` makes an equal one."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)


def known_keys(model: type[BaseModel] = Config, prefix: str = "") -> list[str]:
    """Return the paths of all keys and sections, such as `sim` and `sim.step_s`, depth first."""
    keys = []
    for name, field in model.model_fields.items():
        keys.append(prefix + name)
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            keys += known_keys(field.annotation, f"{prefix}{name}.")
    return keys


def _explain(item: Mapping[str, Any]) -> str:
    """Return a validation error of pydantic as a phrase with key, value and what is allowed."""
    key = ".".join(str(part) for part in item["loc"])
    if item["type"] == "extra_forbidden":
        if key in known_keys():
            nested = "{".join(f"{part}: " for part in key.split(".")) + "..." + "}" * key.count(".")
            return f"unknown configuration key {key!r}; write it as sections: {nested}"
        near = difflib.get_close_matches(key, known_keys(), n=1, cutoff=0.0)
        return f"unknown configuration key {key!r}; the nearest known one is {near[0]!r}"
    message = item["msg"].removeprefix("Value error, ")
    return f"{key} is {item['input']!r}: {message}" if key else message
