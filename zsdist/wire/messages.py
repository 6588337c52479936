"""Messages between roles, one frozen dataclass each.

`sender_epoch` is the incarnation of the sending role. A receiver ignores messages of an incarnation older than the
newest it has received, so a process that was replaced and wakes up again does no harm.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from zsdist.types import Ack, Level, Parameters, StoredBatch, Trajectory, Weights, count_bytes, count_transitions

EPISODES = "episodes"  # stream of records of finished episodes
EVALUATION = "evaluation"  # stream of results of greedy drives
MAX_BATCHES = 16  # most batches in a reply
OBJECTS_PER_TEXT = 8  # bytes that records take in memory, per character of their text


@dataclass(frozen=True)
class Push:
    """Numbered frame of trajectories, actor to replay.

    Attributes:
        stream: level of the trajectories.
        actor: name of the actor.
        epoch: incarnation of the actor, never used twice.
        sequence: number of the frame within (stream, actor, epoch), from 0 without gaps.
        produced: running total of transitions of (stream, actor, epoch), this frame included.
        closes: true for the last frame of the epoch; only this one may be empty.
        trajectories: content of the frame; all have the same state size and number of actions.
        first: whether all frames before this one are acknowledged. A receiver that lacks any of them has lost it for
            good, as a machine that lost power may have.
    """

    stream: Level
    actor: str
    epoch: int
    sequence: int
    produced: int
    closes: bool
    trajectories: Sequence[Trajectory]
    first: bool = False

    @property
    def count(self) -> int:
        """Number of transitions in this frame."""
        return count_transitions(self.trajectories)

    @cached_property
    def nbytes(self) -> int:
        """Bytes of the transitions in memory."""
        return count_bytes(self.trajectories)


@dataclass(frozen=True)
class Records:
    """Numbered frame of JSON records, actor to scheduler, acknowledged like a `Push`; other attributes as there.

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
        """Number of records in this frame."""
        return len(self.records)

    @cached_property
    def nbytes(self) -> int:
        """Bytes of the records in memory, roughly: objects of Python take several times those of their text."""
        return OBJECTS_PER_TEXT * len(str(self.records))


@dataclass(frozen=True)
class SampleRequest:
    """Request of a learner for batches.

    Attributes:
        updates: number of updates of this shard's batches that the learner's networks have had in the whole run.
        batches: most batches that the learner accepts, 1 to `MAX_BATCHES`.
    """

    sender_epoch: int
    level: Level
    updates: int
    batches: int = 1


@dataclass(frozen=True)
class SampleReply:
    """Reply of the replay to a `SampleRequest`.

    Attributes:
        batch: sampled transitions; None if too few are stored, or if the learner is ahead of the data.
        held: number of transitions that the replay holds.
        waited_s: seconds until the request could be served.
        batches: number of batches that were available, which are equal parts of `batch`.
    """

    level: Level
    batch: StoredBatch | None
    held: int
    waited_s: float
    batches: int = 1


@dataclass(frozen=True)
class Priorities:
    """Priorities of transitions that were sampled by priority, learner to replay.

    Attributes:
        serials: `(B,)` int64, serial numbers of the transitions as in the batch.
        errors: `(B,)` float32, absolute temporal-difference errors.
    """

    sender_epoch: int
    level: Level
    serials: np.ndarray
    errors: np.ndarray


@dataclass(frozen=True)
class WeightsMessage:
    """Weights of a level, learner to all actors.

    Attributes:
        merge: number of promotions so far.
        sha256: hash of the parameters, from `zsdist.dqn.network.sha256`.
        made_s: unix seconds at which this version was made, by the learner's clock.
    """

    sender_epoch: int
    merge: int
    sha256: str
    made_s: float
    weights: Weights


@dataclass(frozen=True)
class Candidate:
    """Parameters of the candidate `name` in the merge with number `merge`."""

    sender_epoch: int
    level: Level
    merge: int
    name: str
    parameters: Parameters


@dataclass(frozen=True)
class Orders:
    """Orders of the scheduler to a role: the complete wanted state as a JSON object, sent again from time to time."""

    sender_epoch: int
    role: str
    content: dict[str, Any]


@dataclass(frozen=True)
class Jobs:
    """Orders of the scheduler to one actor: the complete wanted state as a JSON object, sent from time to time."""

    sender_epoch: int
    actor: str
    content: dict[str, Any]


@dataclass(frozen=True)
class Admission:
    """Question of an actor that joins a run from elsewhere, or the answer of the run: a JSON object.

    Attributes:
        actor: name of the actor, which its certificate is for.
        content: a model of `zsdist.roles.schemas`, as JSON.
    """

    actor: str
    content: dict[str, Any]


@dataclass(frozen=True)
class State:
    """Checkpoint of a role: `meta` is a JSON object, and `arrays` stay bit-identical, including NaN and infinity."""

    role: str
    meta: dict[str, Any]
    arrays: dict[str, np.ndarray]

    def part(self, prefix: str) -> dict[str, np.ndarray]:
        """Return the arrays whose names begin with `prefix`, under the rest of their names."""
        return {name.removeprefix(prefix): array for name, array in self.arrays.items() if name.startswith(prefix)}


AnyMessage = (
    Push
    | Records
    | Ack
    | SampleRequest
    | SampleReply
    | Priorities
    | WeightsMessage
    | Candidate
    | Orders
    | Jobs
    | Admission
    | State
)
