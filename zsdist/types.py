"""Data that travels between packages: shapes, dtypes and units.

Shape legend: `n` transitions of a trajectory, `D` state features, `A` actions, `B` batch, `R` camera rays,
`K` distance bins of a ray. The last bin means that nothing is within the camera's range.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import NamedTuple, Self, overload

import numpy as np


class Level(StrEnum):
    """Level of the hierarchy."""

    HIGH = "high"
    LOW = "low"


class Action(IntEnum):
    """Action of the car; there is none backward. An action turns first, then advances."""

    FORWARD = 0
    LEFT_45 = 1  # turn 45 degrees left, then move one cell
    RIGHT_45 = 2
    TURN_LEFT_90 = 3  # in place
    TURN_RIGHT_90 = 4


class Behaviour(IntEnum):
    """Policy that chose an action (column `behaviours` of a trajectory)."""

    GREEDY = 0
    GUIDE = 1
    UNIFORM = 2


class Outcome(StrEnum):
    """Outcome of an episode."""

    SUCCESS = "success"
    COLLISION = "collision"
    TIMEOUT = "timeout"


NO_GUIDE = -1  # guide action where the guide policy has no advice


class Pose(NamedTuple):
    """True pose: `x_m` east and `y_m` north of the arena's centre, `heading_rad` counter-clockwise from east."""

    x_m: float
    y_m: float
    heading_rad: float

    def towards(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return bearing (rad, from the car's axis, left positive, within half a turn) and distance (m) of a point."""
        east, north = x_m - self.x_m, y_m - self.y_m
        return math.remainder(math.atan2(north, east) - self.heading_rad, math.tau), math.hypot(east, north)


class LatticeState(NamedTuple):
    """State of the planning lattice: column `ix` (east), row `iy` (north), `heading` in eighths of a turn."""

    ix: int
    iy: int
    heading: int


@dataclass(frozen=True)
class View:
    """Output of the visual-act model for one image.

    Attributes:
        advice: `(3,)` float32, R_p for forward, left, right (Eq. 3's scale).
        clearance_m: `(3,)` float32, distance to the nearest obstacle in each direction, capped at the camera's range.
        dynamic: `(3,)` float32, probability that this obstacle is one that moves.
        ray_probabilities: `(R, K)` float32, rows sum to 1: distribution over the distance along each ray.
        ray_angles_rad: `(R,)` float32, angle of each ray from the camera's axis, left positive, leftmost first.
        bin_edges_m: `(K,)` float32, edges of the first K - 1 bins; the last bin holds everything beyond the last edge.
    """

    advice: np.ndarray
    clearance_m: np.ndarray
    dynamic: np.ndarray
    ray_probabilities: np.ndarray
    ray_angles_rad: np.ndarray
    bin_edges_m: np.ndarray


@dataclass(frozen=True)
class Trajectory:
    """Transitions that belong together, with each state stored once.

    Transition `i` is `(states[i], actions[i], rewards[i], discounts[i], states[successors[i]])`. At the low level
    `successors[i] == i + 1`; at the high level every low step inside an option is a transition whose successor is the
    state in which the option ended.

    Attributes:
        level: level whose DQN learns from it.
        states: `(n + 1, D)` float32.
        actions: `(n,)` uint8.
        rewards: `(n,)` float32, the reward to learn from (the paper's literal one only if so configured).
        discounts: `(n,)` float32: 0 at goal and collision, else gamma (low) or gamma ** k (high).
        successors: `(n,)` uint16, row of the next state in `states`.
        masks: `(n + 1, A)` bool, actions allowed in each state.
        guides: `(n,)` int8, the guide policy's action (`NO_GUIDE`: none).
        behaviours: `(n,)` uint8, `Behaviour`.
        weight_version: version of the weights when the episode began; the actor uses newer ones as soon as they arrive.
    """

    level: Level
    states: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    discounts: np.ndarray
    successors: np.ndarray
    masks: np.ndarray
    guides: np.ndarray
    behaviours: np.ndarray
    weight_version: int

    def __len__(self) -> int:
        return len(self.actions)


TRAJECTORY_COLUMNS = ("states", "actions", "rewards", "discounts", "successors", "masks", "guides", "behaviours")


@dataclass(frozen=True)
class Trajectories(Sequence[Trajectory]):
    """Trajectories of one level joined column by column; split only where a single one is requested.

    Attributes:
        level: level whose DQN learns from them.
        columns: the arrays of `Trajectory` by name, each joined along its first axis; states that have travelled are
            float16.
        lengths: `(k,)` int64, transitions of each; 1 or more.
        versions: `(k,)` int64, version of the weights that acted.
    """

    level: Level
    columns: dict[str, np.ndarray]
    lengths: np.ndarray
    versions: np.ndarray

    @classmethod
    def join(cls, trajectories: Sequence[Trajectory]) -> Self:
        """Join one or more trajectories of one level."""
        return cls(
            level=trajectories[0].level,
            columns={
                name: np.concatenate([getattr(trajectory, name) for trajectory in trajectories])
                for name in TRAJECTORY_COLUMNS
            },
            lengths=np.array([len(trajectory) for trajectory in trajectories]),
            versions=np.array([trajectory.weight_version for trajectory in trajectories]),
        )

    def __len__(self) -> int:
        return len(self.lengths)

    @overload
    def __getitem__(self, index: int) -> Trajectory: ...

    @overload
    def __getitem__(self, index: slice) -> list[Trajectory]: ...

    def __getitem__(self, index: int | slice) -> Trajectory | list[Trajectory]:
        if isinstance(index, slice):
            return [self[each] for each in range(len(self))[index]]
        index = range(len(self))[index]
        start, length = int(self.lengths[:index].sum()), int(self.lengths[index])
        row = start + index  # each trajectory before this one has one more state than transitions
        spans = {name: slice(start, start + length) for name in TRAJECTORY_COLUMNS}
        spans["states"] = spans["masks"] = slice(row, row + length + 1)
        own = {name: self.columns[name][span] for name, span in spans.items()}
        own["states"] = own["states"].astype(np.float32, copy=False)
        return Trajectory(level=self.level, weight_version=int(self.versions[index]), **own)


def count_transitions(trajectories: Iterable[Trajectory]) -> int:
    """Return the number of transitions of all trajectories."""
    if isinstance(trajectories, Trajectories):
        return int(trajectories.lengths.sum())
    return sum(map(len, trajectories))


def count_bytes(trajectories: Iterable[Trajectory]) -> int:
    """Return the bytes of the arrays of all trajectories."""
    if isinstance(trajectories, Trajectories):
        return sum(column.nbytes for column in trajectories.columns.values())
    return sum(getattr(trajectory, name).nbytes for trajectory in trajectories for name in TRAJECTORY_COLUMNS)


@dataclass(frozen=True)
class _BatchColumns:
    """Columns of `B` transitions, one row each; the subclasses state the dtypes."""

    states: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    discounts: np.ndarray
    next_states: np.ndarray
    next_masks: np.ndarray
    masks: np.ndarray
    guides: np.ndarray
    weights: np.ndarray | None = None
    serials: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.actions)

    def parts(self, count: int) -> list[Self]:
        """Return `count` equal parts that share its memory, in order; `count` must divide its length."""
        size = len(self) // count
        columns = {name: column for name, column in vars(self).items() if column is not None}
        return [
            type(self)(**{name: column[start : start + size] for name, column in columns.items()})
            for start in range(0, len(self), size)
        ]


class StoredBatch(_BatchColumns):
    """Sample of one level's replay in the dtypes of storage and transport.

    Attributes:
        states: `(B, D)` float16.            next_states: `(B, D)` float16.
        actions: `(B,)` uint8.               next_masks: `(B, A)` bool.
        rewards: `(B,)` float32.             masks: `(B, A)` bool.
        discounts: `(B,)` float32.           guides: `(B,)` int8.
        weights: `(B,)` float32 in (0, 1], importance weights of rows drawn by priority; None: drawn uniformly.
        serials: `(B,)` int64, numbers of the rows in the replay; None where `weights` is None.
    """


class Batch(_BatchColumns):
    """Sample of one level's replay in the dtypes of a learner.

    Attributes:
        states: `(B, D)` float32.            next_states: `(B, D)` float32.
        actions: `(B,)` int64.               next_masks: `(B, A)` bool.
        rewards: `(B,)` float32.             masks: `(B, A)` bool.
        discounts: `(B,)` float32.           guides: `(B,)` int64.
        weights: `(B,)` float32 in (0, 1], importance weights of rows drawn by priority; None: drawn uniformly.
        serials: `(B,)` int64, numbers of the rows in the replay; None where `weights` is None.
    """


@dataclass(frozen=True)
class Mirror:
    """Left-right reflection of a level's states and actions; applied twice it changes nothing.

    The reflected state is `state_sign * state[state_index]`.

    Attributes:
        state_index: `(D,)` int64, feature that takes each feature's place.
        state_sign: `(D,)` float32, +1 or -1.
        action_index: `(A,)` int64, action that each action becomes.
    """

    state_index: np.ndarray
    state_sign: np.ndarray
    action_index: np.ndarray


Parameters = dict[str, np.ndarray]  # a network's weights by name, float32


@dataclass(frozen=True)
class Weights:
    """One version of a level's policy network, as broadcast by its learner.

    Attributes:
        level: level of the network.
        version: number of the version, which grows with each change of the weights.
        parameters: weights of the network.
    """

    level: Level
    version: int
    parameters: Parameters


MAX_REASON = 200  # characters of `Ack.refused`


@dataclass(frozen=True)
class Ack:
    """Acknowledgement: frames that a receiver holds of one (stream, actor, epoch), and the credit to send more.

    Attributes:
        sender_epoch: epoch of the receiver, which sends this.
        actor: name of the actor whose frames are acknowledged.
        epoch: epoch of the actor.
        stream: name of the stream.
        received: number below which the receiver holds every frame.
        credit: absolute total of transitions that the stream may produce in this epoch; None: unlimited.
        refused: why the receiver refused a frame since it last accepted one; empty: it refused none.
    """

    sender_epoch: int
    actor: str
    epoch: int
    stream: str
    received: int
    credit: int | None
    refused: str = ""
