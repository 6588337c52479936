"""What may be in the JSON parts of messages: orders, jobs, records, and states that go into checkpoints.

The codec knows these only as JSON objects. A receiver reads them through the models here before it acts on anything, so
that a message which is sound as bytes and senseless as an order is refused and counted like any other. Numbers are
bounded, so that sums of them stay finite.
"""

from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError

from zsdist.errors import DecodeError
from zsdist.roles.scheduler.merge import BEST, DISTILLED, RECENT, Phase
from zsdist.types import Outcome
from zsdist.wire.codec import MAX_COUNT
from zsdist.wire.messages import EPISODES, Records, State

MAX_ACTORS, MAX_LEASES, MAX_DRIVES, MAX_PATH = 4096, 256, 65_536, 65_536

Count = Annotated[int, Field(ge=0, lt=MAX_COUNT)]
Number = Annotated[int, Field(ge=1, lt=2**31)]  # of an episode
Figure = Annotated[float, Field(ge=-1e12, le=1e12)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{1,64}$")]
Text = Annotated[str, Field(max_length=1000)]
Point = Annotated[list[Figure], Field(min_length=2, max_length=2)]
Epochs = Annotated[dict[Name, Count], Field(max_length=MAX_ACTORS)]
CandidateName = Literal[RECENT, DISTILLED, BEST]


class Content(BaseModel):
    """One kind of content: exactly these fields, of exactly these types."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")


class ActorOrders(Content):
    """To all actors: who drives which episode, and how the run stands."""

    epochs: Epochs
    leases: dict[Name, Annotated[list[Number], Field(max_length=MAX_LEASES)]]
    finished: Count
    merge: Count
    closing: bool
    cut: bool


class ReplayOrders(Content):
    """To the replay: whom to listen to, and how large to be."""

    epochs: Epochs
    buffer_size: Annotated[int, Field(ge=1)]
    batch_size: Annotated[int, Field(ge=1)]
    stop: bool


class LearnerOrders(Content):
    """To the learners: whether to learn, and where the merge stands."""

    learning: bool
    merge: Count
    phase: Annotated[Phase, Strict(False)] | Literal[""]
    candidates: Annotated[list[CandidateName], Field(max_length=8)]
    chosen: CandidateName | Literal[""]
    stop: bool


class Supervision(Content):
    """To the scheduler, from the runner: the actors' incarnations, processes replaced, and whether to stop early."""

    epochs: Epochs
    restarts: Annotated[dict[Name, Count], Field(max_length=64)]
    interrupted: bool


class StateRequest(Content):
    """To a role that has a state: the question for it."""

    ask: Literal["state"]


class DriveJobs(Content):
    """To one actor: candidates to drive, as (name, index of the validation scene)."""

    merge: Count
    drives: Annotated[list[Annotated[tuple[CandidateName, Count], Strict(False)]], Field(max_length=MAX_DRIVES)]


class _Drive(Content):
    """How a drive ended; more figures by name may follow."""

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


class TrainingRecord(_Drive):
    """How a training episode ended."""

    episode: Number


class CandidateRecord(_Drive):
    """How a candidate's drive ended."""

    scene_index: Count
    merge: Count
    candidate: CandidateName


class LevelReplayState(Content):
    """What the scheduler reads of a replay's state, for each level."""

    model_config = ConfigDict(extra="allow")

    open: Count
    books: dict[Name, Count]


class LearnerState(Content):
    """What the scheduler reads of a learner's state."""

    model_config = ConfigDict(extra="allow")

    version: Count
    updates: Count
    merge: Count
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


Some = TypeVar("Some", bound=Content)


def read(model: type[Some], content: dict[str, Any]) -> Some:
    """Content as its model; raises `DecodeError` with the reason `content` where it is none."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise DecodeError("content", f"{model.__name__} {where}: {first['msg']}"[:200]) from error


def drives(records: Records) -> list[Content]:
    """The records of a frame, each of the actor that sends them; raises `DecodeError` where one is not."""
    model = TrainingRecord if records.stream == EPISODES else CandidateRecord
    found = [read(model, record) for record in records.records]
    for one in found:
        if one.actor != records.actor:
            raise DecodeError("actor", f"a record of {one.actor} from {records.actor}")
    return found


def parts(state: State) -> list[Content]:
    """What the scheduler reads of a role's state; raises `DecodeError` where it is not there."""
    if state.role.startswith("learner-"):
        return [read(LearnerState, state.meta)]
    return [read(LevelReplayState, part) for part in state.meta.values()]
