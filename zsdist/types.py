"""The data that travels between packages: shapes, dtypes and units.

Shape legend: `n` transitions of a trajectory, `D` state features, `A` actions, `B` batch, `R` camera rays,
`K` distance bins of a ray, the last of which means "nothing within the camera's range".
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import NamedTuple, Self, overload

import numpy as np


class Level(StrEnum):
    """The two levels of the hierarchy."""

    HIGH = "high"
    LOW = "low"


class Action(IntEnum):
    """What the car can be told to do; never backward. The turn of an action comes before its advance."""

    FORWARD = 0
    LEFT_45 = 1  # turn 45 degrees left, then move one cell
    RIGHT_45 = 2
    TURN_LEFT_90 = 3  # in place
    TURN_RIGHT_90 = 4


class Behaviour(IntEnum):
    """Which policy chose an action (column `behaviours` of a trajectory)."""

    GREEDY = 0
    GUIDE = 1
    UNIFORM = 2


class Outcome(StrEnum):
    """How an episode ended."""

    SUCCESS = "success"
    COLLISION = "collision"
    TIMEOUT = "timeout"


NO_GUIDE = -1  # guide action where the guide policy has no advice


class Pose(NamedTuple):
    """A true pose: `x_m` east, `y_m` north of the arena's centre, `heading_rad` counter-clockwise from east."""

    x_m: float
    y_m: float
    heading_rad: float

    def towards(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Bearing of a point from the car's axis in radians, left positive, within half a turn; distance in metres."""
        east, north = x_m - self.x_m, y_m - self.y_m
        return math.remainder(math.atan2(north, east) - self.heading_rad, math.tau), math.hypot(east, north)


class LatticeState(NamedTuple):
    """A state of the planning lattice: column `ix` (east), row `iy` (north), `heading` in eighths of a turn."""

    ix: int
    iy: int
    heading: int


@dataclass(frozen=True)
class View:
    """What the visual-act model says of one image.

    Attributes:
        advice: `(3,)` float32, R_p for forward, left, right (Eq. 3's scale).
        clearance_m: `(3,)` float32, distance to the nearest obstacle in each direction, capped at the camera's range.
        dynamic: `(3,)` float32, probability that this obstacle is one that moves.
        ray_probabilities: `(R, K)` float32, rows sum to 1: distribution over the distance along each ray.
        ray_angles_rad: `(R,)` float32, angle of each ray from the camera's axis, left positive, leftmost first.
        bin_edges_m: `(K,)` float32, edges of the first K - 1 bins; the last bin is everything beyond the last edge.
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
        level: which DQN it is for.
        states: `(n + 1, D)` float32.
        actions: `(n,)` uint8.
        rewards: `(n,)` float32, as learned from (not the paper's literal reward unless so configured).
        discounts: `(n,)` float32: 0 at goal and collision, else gamma (low) or gamma ** k (high).
        successors: `(n,)` uint16, row of `states` that follows.
        masks: `(n + 1, A)` bool, actions that may be taken in each state.
        guides: `(n,)` int8, the guide policy's action (`NO_GUIDE`: none).
        behaviours: `(n,)` uint8, `Behaviour`.
        weight_version: version of the weights when the episode began; newer ones act as soon as they come.
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
    """Trajectories of a level one after the other, column by column; taken apart only where one of them is asked for.

    Attributes:
        level: which DQN they are for.
        columns: the arrays of `Trajectory` by name, each joined along its first axis; states that have travelled are
            float16 here.
        lengths: `(k,)` int64, transitions of each; 1 or more.
        versions: `(k,)` int64, version of the weights that acted.
    """

    level: Level
    columns: dict[str, np.ndarray]
    lengths: np.ndarray
    versions: np.ndarray

    @classmethod
    def join(cls, trajectories: Sequence[Trajectory]) -> Self:
        """The same trajectories, at least one, joined."""
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
    """How many transitions trajectories have together."""
    if isinstance(trajectories, Trajectories):
        return int(trajectories.lengths.sum())
    return sum(map(len, trajectories))


@dataclass(frozen=True)
class _BatchColumns:
    """Columns of `B` transitions, a row each; the subclasses state the dtypes."""

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
        """Return `count` equal parts, one after the other, which share its memory; `count` must divide its length."""
        size = len(self) // count
        columns = {name: column for name, column in vars(self).items() if column is not None}
        return [
            type(self)(**{name: column[start : start + size] for name, column in columns.items()})
            for start in range(0, len(self), size)
        ]


class StoredBatch(_BatchColumns):
    """A sample of one level's replay in the dtypes in which the replay holds it and in which it travels.

    Attributes:
        states: `(B, D)` float16.            next_states: `(B, D)` float16.
        actions: `(B,)` uint8.               next_masks: `(B, A)` bool.
        rewards: `(B,)` float32.             masks: `(B, A)` bool.
        discounts: `(B,)` float32.           guides: `(B,)` int8.
        weights: `(B,)` float32 in (0, 1], importance weights of rows drawn by priority; None: drawn uniformly.
        serials: `(B,)` int64, numbers of the rows in the replay; None where `weights` is None.
    """


class Batch(_BatchColumns):
    """A sample of one level's replay in the dtypes that a learner computes with.

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
    """One version of one level's online network, as broadcast by its learner."""

    level: Level
    version: int
    parameters: Parameters


@dataclass(frozen=True)
class Ack:
    """What a receiver holds of one (stream, actor, epoch), and what it may still be sent.

    Attributes:
        sender_epoch: incarnation of the receiver, which is the sender of this.
        received: every frame numbered below this is held.
        credit: absolute total of transitions the stream may produce in this epoch; None: unlimited.
    """

    sender_epoch: int
    actor: str
    epoch: int
    stream: str
    received: int
    credit: int | None
