"""Collection of the roles' states for a checkpoint, as a state machine without messages."""

from typing import NamedTuple

from zsdist.config import Config, RunConfig
from zsdist.errors import DecodeError
from zsdist.roles import schemas
from zsdist.roles.base import HEARTBEAT_S
from zsdist.roles.replay import shards
from zsdist.transport.base import Message
from zsdist.types import Level
from zsdist.wire import addresses, codec
from zsdist.wire.messages import State

ANSWER_WITHIN_S = 10.0  # a role that has not answered by then is asked again


class Answer(NamedTuple):
    """State of a role as it answered.

    Attributes:
        state: the state without its arrays.
        payload: the whole state as it was sent.
    """

    state: State
    payload: bytes


def read_answer(message: Message, run: str) -> Answer | DecodeError:
    """Return a role's answer, or why it is refused; nothing but the arguments is used, so any thread may call it."""
    try:
        state = codec.decode(message.payload, expect=State)
        addresses.require(message.key, run, state)
        schemas.check_state(state)
    except DecodeError as error:
        return error
    return Answer(State(state.role, state.meta, {}), message.payload)


class CheckpointSchedule:
    """Decision when the next checkpoint of a training is due: after so many episodes, or after so much time.

    Args:
        settings: settings `checkpoint_every_episodes` and `checkpoint_every_s`.
    """

    def __init__(self, settings: RunConfig) -> None:
        self._settings = settings
        self._episodes = 0  # finished at the last checkpoint
        self._made_s: float | None = None  # time of the last checkpoint, or of the first question
        self._demanded = False

    def is_due(self, finished: int, now: float) -> bool:
        """Return whether a checkpoint is due.

        Args:
            finished: number of finished episodes.
            now: time, seconds.
        """
        if self._made_s is None or self._made_s > now:  # the clock was set back
            self._made_s = now
        episodes, age_s = finished - self._episodes, now - self._made_s
        late = episodes >= self._settings.checkpoint_every_episodes or age_s >= self._settings.checkpoint_every_s
        return late or self._demanded

    def demand(self) -> None:
        """Make a checkpoint due."""
        self._demanded = True

    def note_checkpoint(self, finished: int, now: float | None = None, demanded: bool = False) -> None:
        """Count from a checkpoint.

        Args:
            finished: number of finished episodes at the checkpoint.
            now: its time, seconds; None for that of an earlier start.
            demanded: whether another one has been demanded since.
        """
        self._episodes, self._made_s, self._demanded = finished, now, demanded

    def state(self) -> tuple[int, float | None, bool]:
        """Return the arguments for `note_checkpoint` that make a schedule like this one."""
        return self._episodes, self._made_s, self._demanded


class StateCollection:
    """States of all roles that have one, except the scheduler's own.

    Attributes:
        shards: names of the replay's shards.
        names: names of all roles that are asked.
    """

    def __init__(self, config: Config) -> None:
        self.shards = shards.state_names(config)
        self.names = [*self.shards, *(f"learner-{level}" for level in Level)]
        self._answers: dict[str, Answer] = {}
        self._ask_again_s = 0.0
        self._asked = False

    def statistics(self) -> dict[str, str]:
        """Return the names of the roles that were asked and have not answered yet, as `states_awaited`."""
        missing = self._missing() if self._asked else []
        return {"states_awaited": " ".join(missing)[:200]} if missing else {}

    def clear(self) -> None:
        """Forget all states, so that `due` names every role at once."""
        self._answers, self._ask_again_s, self._asked = {}, 0.0, False

    def accept(self, answer: Answer) -> None:
        """Keep an answer, in place of an earlier one of the same role."""
        self._answers[answer.state.role] = answer

    def drop_open(self, now: float) -> None:
        """Forget the states of shards that still expect frames; they are asked again after a heartbeat."""
        for name in self.shards:
            if name in self._answers and any(part["open"] for part in self._answers[name].state.meta.values()):
                del self._answers[name]
                self._ask_again_s = now + HEARTBEAT_S

    def take(self) -> dict[str, Answer] | None:
        """Return all answers and forget them; None, and nothing is forgotten, while one is missing."""
        if self._missing():
            return None
        answers = self._answers
        self.clear()
        return answers

    def due(self, now: float) -> list[str]:
        """Return the names of the roles to ask now."""
        if now < self._ask_again_s:
            return []
        self._ask_again_s, self._asked = now + ANSWER_WITHIN_S, True
        return self._missing()

    def _missing(self) -> list[str]:
        return [name for name in self.names if name not in self._answers]
