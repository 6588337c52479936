"""One frozen dataclass per arrow between roles.

`sender_epoch` numbers the incarnation of the sending role: a receiver ignores messages older than the newest it has
heard, so that a process that was replaced and wakes up again can do no harm.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from zsdist.types import Ack, Level, Parameters, StoredBatch, Trajectory, Weights, count_transitions

EPISODES = "episodes"  # stream of how each episode ended
EVALUATION = "evaluation"  # stream of the results of greedy drives
MAX_BATCHES = 16  # of an answer


@dataclass(frozen=True)
class Push:
    """A numbered frame of trajectories, actor to replay.

    Attributes:
        stream: the level whose transitions these are.
        actor: name of the actor.
        epoch: incarnation of the actor, never used twice.
        sequence: number of the frame within (stream, actor, epoch), from 0, contiguous.
        produced: running total of transitions of (stream, actor, epoch), this frame included.
        closes: this is the last frame of the epoch; only such a frame may be empty.
        trajectories: what it carries; all have the same state size and number of actions.
    """

    stream: Level
    actor: str
    epoch: int
    sequence: int
    produced: int
    closes: bool
    trajectories: Sequence[Trajectory]

    @property
    def count(self) -> int:
        """Transitions in this frame."""
        return count_transitions(self.trajectories)


@dataclass(frozen=True)
class Records:
    """A numbered frame of JSON records, actor to scheduler; acknowledged like a push.

    Attributes:
        stream: `EPISODES` or `EVALUATION`.
        produced: running total of records of (stream, actor, epoch), this frame included.
        records: JSON objects with string keys and finite numbers.
    """

    stream: str
    actor: str
    epoch: int
    sequence: int
    produced: int
    closes: bool
    records: tuple[dict[str, Any], ...]

    @property
    def count(self) -> int:
        """Records in this frame."""
        return len(self.records)


@dataclass(frozen=True)
class SampleRequest:
    """A learner asks for batches.

    Attributes:
        updates: how many it has made so far.
        batches: how many it can take, 1 to `MAX_BATCHES`.
    """

    sender_epoch: int
    level: Level
    updates: int
    batches: int = 1


@dataclass(frozen=True)
class SampleReply:
    """The replay's answer.

    Attributes:
        batch: None where there is none to be had: too little is stored, or the learner is ahead of the data.
        held: transitions that the replay holds.
        waited_s: how long the request waited until there was one to be had.
        batches: so many equal parts of `batch` are a batch each, as many as there were to be had at once.
    """

    level: Level
    batch: StoredBatch | None
    held: int
    waited_s: float
    batches: int = 1


@dataclass(frozen=True)
class Priorities:
    """What a learner found of the rows of a batch that were drawn by priority.

    Attributes:
        serials: `(B,)` int64, as the batch has them.
        errors: `(B,)` float32, absolute temporal-difference errors.
    """

    sender_epoch: int
    level: Level
    serials: np.ndarray
    errors: np.ndarray


@dataclass(frozen=True)
class WeightsMessage:
    """A learner's weights for every actor.

    Attributes:
        merge: promotions so far.
        sha256: of the parameters.
        made_s: unix seconds at which this version came to be, by the learner's clock.
    """

    sender_epoch: int
    merge: int
    sha256: str
    made_s: float
    weights: Weights


@dataclass(frozen=True)
class Candidate:
    """Parameters under the name `name` that stand for promotion in merge number `merge`."""

    sender_epoch: int
    level: Level
    merge: int
    name: str
    parameters: Parameters


@dataclass(frozen=True)
class Orders:
    """The scheduler's word to one role: an absolute state (a JSON object), sent again from time to time."""

    sender_epoch: int
    role: str
    content: dict[str, Any]


@dataclass(frozen=True)
class Jobs:
    """Greedy drives the scheduler asks one actor for: an absolute state (a JSON object)."""

    sender_epoch: int
    actor: str
    content: dict[str, Any]


@dataclass(frozen=True)
class State:
    """A role's checkpoint: `meta` is a JSON object; `arrays` are kept bit for bit, NaN and infinity included."""

    role: str
    meta: dict[str, Any]
    arrays: dict[str, np.ndarray]

    def part(self, prefix: str) -> dict[str, np.ndarray]:
        """The arrays whose names begin with `prefix`, under the rest of their names."""
        return {name.removeprefix(prefix): array for name, array in self.arrays.items() if name.startswith(prefix)}


AnyMessage = (
    Push | Records | Ack | SampleRequest | SampleReply | Priorities | WeightsMessage | Candidate | Orders | Jobs | State
)
