"""Collection of the roles' states for a checkpoint, as a state machine without messages."""

from zsdist.config import Config, RunConfig
from zsdist.roles.base import HEARTBEAT_S
from zsdist.roles.replay import shards
from zsdist.types import Level
from zsdist.wire.messages import State

ANSWER_WITHIN_S = 10.0  # a role that has not answered by then is asked again


class CheckpointSchedule:
    """Decision when the next checkpoint of a training is due: after so many episodes, or after so much time.

    Args:
        settings: settings `checkpoint_every_episodes` and `checkpoint_every_s`.
    """

    def __init__(self, settings: RunConfig) -> None:
        self._settings = settings
        self._episodes = 0  # finished at the last checkpoint
        self._made_s: float | None = None  # time of the last checkpoint, or of the first question

    def is_due(self, finished: int, now: float) -> bool:
        """Return whether a checkpoint is due.

        Args:
            finished: number of finished episodes.
            now: time, seconds.
        """
        if self._made_s is None or self._made_s > now:  # the clock was set back
            self._made_s = now
        episodes, age_s = finished - self._episodes, now - self._made_s
        return episodes >= self._settings.checkpoint_every_episodes or age_s >= self._settings.checkpoint_every_s

    def note_checkpoint(self, finished: int, now: float | None = None) -> None:
        """Count from a checkpoint after `finished` episodes; `now` is None for that of an earlier start."""
        self._episodes, self._made_s = finished, now

    def state(self) -> tuple[int, float | None]:
        """Return the arguments for `note_checkpoint` that make a schedule like this one."""
        return self._episodes, self._made_s


class StateCollection:
    """States of all roles that have one, except the scheduler's own.

    Attributes:
        shards: names of the replay's shards.
        names: names of all roles that are asked.
    """

    def __init__(self, config: Config) -> None:
        self.shards = shards.state_names(config)
        self.names = [*self.shards, *(f"learner-{level}" for level in Level)]
        self._states: dict[str, State] = {}
        self._ask_again_s = 0.0
        self._asked = False

    def statistics(self) -> dict[str, str]:
        """Return the names of the roles that were asked and have not answered yet, as `states_awaited`."""
        missing = self._missing() if self._asked else []
        return {"states_awaited": " ".join(missing)[:200]} if missing else {}

    def clear(self) -> None:
        """Forget all states, so that `due` names every role at once."""
        self._states, self._ask_again_s, self._asked = {}, 0.0, False

    def accept(self, state: State) -> None:
        """Keep a state, in place of an earlier one of the same role."""
        self._states[state.role] = state

    def drop_open(self, now: float) -> None:
        """Forget the states of shards that still expect frames; they are asked again after a heartbeat."""
        for name in self.shards:
            if name in self._states and any(part["open"] for part in self._states[name].meta.values()):
                del self._states[name]
                self._ask_again_s = now + HEARTBEAT_S

    def take(self) -> dict[str, State] | None:
        """Return all states and forget them; None, and nothing is forgotten, while one is missing."""
        if self._missing():
            return None
        states = self._states
        self.clear()
        return states

    def due(self, now: float) -> list[str]:
        """Return the names of the roles to ask now."""
        if now < self._ask_again_s:
            return []
        self._ask_again_s, self._asked = now + ANSWER_WITHIN_S, True
        return self._missing()

    def _missing(self) -> list[str]:
        return [name for name in self.names if name not in self._states]
