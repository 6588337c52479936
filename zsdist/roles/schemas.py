"""Models of the JSON parts of messages: orders, jobs, records, and states that go into checkpoints.

The codec knows these parts only as JSON objects. A receiver validates them by the models here before it acts on them.
A message that is well-formed as bytes and invalid as an order is refused and counted like any other. Numbers are
bounded, so that sums of them stay finite.
"""

from collections.abc import Sequence
from typing import Annotated, Any, Final, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError

from zsdist.errors import DecodeError
from zsdist.roles.permissions import MAX_ACTORS
from zsdist.types import Outcome
from zsdist.wire.codec import MAX_COUNT
from zsdist.wire.messages import EPISODES, Records, State

MAX_LEASES, MAX_DRIVES, MAX_PATH = 256, 65_536, 65_536

Count = Annotated[int, Field(ge=0, lt=MAX_COUNT)]
Number = Annotated[int, Field(ge=1, lt=2**31)]  # number of an episode
Figure = Annotated[float, Field(ge=-1e12, le=1e12)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{1,64}$")]
Text = Annotated[str, Field(max_length=1000)]
Point = Annotated[list[Figure], Field(min_length=2, max_length=2)]
Epochs = Annotated[dict[Name, Count], Field(max_length=MAX_ACTORS)]

CandidateName = Literal["recent", "distilled", "best"]
RECENT: Final = "recent"  # the online networks as they are
DISTILLED: Final = "distilled"  # the recent ones after updates that pull them towards the guide's actions
BEST: Final = "best"  # the winner of the last merge: the paper's "historical strategies"


class Content(BaseModel):
    """Base of all models: exactly these fields, of exactly these types."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")


class ActorOrders(Content):
    """Orders to all actors: the progress of the run. They are as long for many actors as for one.

    `leasing` tells whether there are episodes that nobody holds yet: whoever has none soon gets one.
    """

    leasing: bool = False
    finished: Count
    merge: Count
    closing: bool
    cut: bool


class ReplayOrders(Content):
    """Orders to the replay: the actors whose pushes it accepts, those that have left for good, and its sizes."""

    epochs: Epochs
    left: Epochs = {}
    buffer_size: Annotated[int, Field(ge=1)]
    batch_size: Annotated[int, Field(ge=1)]
    stop: bool


class LearnerOrders(Content):
    """Orders to the learners: whether to learn, the merge under way, and the progress of the run.

    `merge` is the index of the merge, 0 without one, and `candidates` names those that a learner has to offer in it.
    `driven` counts their drives so far. `chosen` is the winner, which a learner has to promote; empty while there is
    none.
    """

    learning: bool
    finished: Count = 0
    merge: Count
    candidates: Annotated[list[CandidateName], Field(max_length=8)]
    driven: Count = 0
    chosen: CandidateName | Literal[""]
    stop: bool


class Supervision(Content):
    """Orders of the runner to the scheduler.

    They name the epochs of the actors, the restarts by kind of role, whether to stop, and the number of finished
    episodes at which all roles close after a checkpoint; None: they close at the end of the run, after its summary.
    An actor that is not named may be unknown to a runner that has just begun. One in `left` is gone: it has left, or
    its process has died and no other one is there yet.
    """

    epochs: Epochs
    left: Epochs = {}
    restarts: Annotated[dict[Name, Count], Field(max_length=64)]
    interrupted: bool
    until: Count | None = None


class StateRequest(Content):
    """Request to a role for its state; older incarnations of it than `epoch` do not answer."""

    ask: Literal["state"]
    epoch: Count = 0


class JoinRequest(Content):
    """Question of a process that wants to be an actor: the run's terms, an epoch, or to leave again.

    `joiner` names the command that has started the process, `process` the process itself. Both are unique words.
    """

    ask: Literal["terms", "epoch", "leave"]
    joiner: Name
    process: Name


class JoinTerms(Content):
    """Answer of a run: all that an actor needs to know of it, and the actors that it has already."""

    run: Name
    start: Name
    version: Text
    settings: dict[str, Any]
    vision: dict[Name, Text]
    taken: Annotated[list[Name], Field(max_length=MAX_ACTORS)]


class JoinVerdict(Content):
    """Answer of a run: the epoch of a new actor, or the reason for which it gets none."""

    start: Name
    epoch: Count | None
    reason: Text


class ActorJobs(Content):
    """Orders to one actor: episodes to drive, and candidates, as (name, index of the validation scene).

    They are for the incarnation `epoch`; None: the actor takes no part in the run any more. `finished` is the count of
    the run's finished episodes at the time of the leases.
    """

    epoch: Count | None
    leases: Annotated[list[Number], Field(max_length=MAX_LEASES)]
    finished: Count
    merge: Count
    drives: Annotated[list[Annotated[tuple[CandidateName, Count], Strict(False)]], Field(max_length=MAX_DRIVES)]


class DriveRecord(Content):
    """Result of a drive; further figures by name are allowed."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[Name, Figure | Text]

    actor: Name
    scene: Text
    outcome: Annotated[Outcome, Strict(False)]
    steps: Annotated[int, Field(ge=0, lt=2**31)]
    total: Annotated[Figure, Field(alias="return")]
    epsilon: Annotated[float, Field(ge=0, le=1)]
    shielded: bool
    path_m: Annotated[Figure, Field(ge=0)]
    start: Point
    goal: Point
    path: Annotated[list[Point], Field(min_length=1, max_length=MAX_PATH)]


class TrainingRecord(DriveRecord):
    """Result of a training episode."""

    episode: Number


class CandidateRecord(DriveRecord):
    """Result of a candidate's drive over one validation scene."""

    scene_index: Count
    merge: Count
    candidate: CandidateName


class LevelReplayState(Content):
    """Fields that the scheduler reads from one level's state of a replay."""

    model_config = ConfigDict(extra="allow")

    open: Count
    books: dict[Name, Count]


class LearnerState(Content):
    """Fields that the scheduler reads from a learner's state."""

    model_config = ConfigDict(extra="allow")

    version: Count
    updates: Count
    merge: Count
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


Model = TypeVar("Model", bound=Content)


def read(model: type[Model], content: dict[str, Any]) -> Model:
    """Return `content` as an instance of `model`.

    Raises:
        DecodeError: with the reason `content`, where it does not fit the model.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(str(part) for part in first["loc"])
        found = repr(first["input"])[:40]
        raise DecodeError("content", f"{model.__name__} {field} is {found}: {first['msg']}"[:200]) from error


def check_record(stream: str, record: dict[str, Any]) -> DriveRecord:
    """Return a record, read by the model of its stream; raise `DecodeError` where it does not fit."""
    return read(TrainingRecord if stream == EPISODES else CandidateRecord, record)


def check_records(records: Records) -> Sequence[DriveRecord]:
    """Return the records of a frame, read by the model of its stream.

    Raises:
        DecodeError: a record does not fit the model, or names another actor than the frame does.
    """
    found = [check_record(records.stream, record) for record in records.records]
    for record in found:
        if record.actor != records.actor:
            raise DecodeError("actor", f"a record of {record.actor} from {records.actor}")
    return found


def check_state(state: State) -> Sequence[LearnerState | LevelReplayState]:
    """Return the parts of a role's state that the scheduler reads.

    Raises:
        DecodeError: they are missing or invalid.
    """
    if state.role.startswith("learner-"):
        return [read(LearnerState, state.meta)]
    return [read(LevelReplayState, part) for part in state.meta.values()]
