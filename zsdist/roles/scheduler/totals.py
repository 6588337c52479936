"""Totals of a run over all its starts; the sizes of the replay follow from them."""

from collections import Counter
from typing import Any

from zsdist.config import Config
from zsdist.replay.sizing import AdaptiveSizing, RewardAverages
from zsdist.roles.scheduler.merge import MergeSummary
from zsdist.telemetry.snapshot import Fields
from zsdist.types import Outcome

RECENT_EPISODES = 50  # number of episodes whose success rate is shown to watchers


class RunTotals:
    """Totals of a run, earlier starts included.

    Attributes:
        outcomes: count of finished episodes by outcome.
        env_steps: number of actions in finished episodes.
        averages: averages of return and reward.
        sizing: sizes of the replay and of its batches, which follow the averages.
        merges: entries of the finished merges.
        restarts_before: restarts in earlier starts, by kind of role.
        restarts_now: restarts in this start, by kind of role.
    """

    def __init__(self, config: Config) -> None:
        self.outcomes = dict.fromkeys(Outcome, 0)
        self.env_steps = 0
        self.averages = RewardAverages(config.replay.average_episodes)
        self.sizing = AdaptiveSizing(config.replay)
        self.merges: list[MergeSummary] = []
        self._recent: list[Outcome] = []
        self.restarts_before: dict[str, int] = {}
        self.restarts_now: dict[str, int] = {}

    @property
    def score(self) -> float | None:
        """Score of the network that won the newest merge; None: there has been none."""
        return self.merges[-1]["scores"][self.merges[-1]["chosen"]] if self.merges else None

    def add_episode(self, record: dict[str, Any], finished: int) -> None:
        """Count one finished episode, and adapt the sizes of the replay to the returns.

        Args:
            record: record of the episode.
            finished: count of finished episodes, this one included.
        """
        outcome = Outcome(record["outcome"])
        self.outcomes[outcome] += 1
        self.env_steps += record["steps"]
        self.averages.add_episode(record["return"], record["steps"])
        self.sizing.adjust(finished, self.averages.mean_return)
        self._recent = [*self._recent[1 - RECENT_EPISODES :], outcome]

    def set_restarts(self, restarts: dict[str, int]) -> bool:
        """Store the restarts in this start by kind of role; return whether they changed."""
        if restarts == self.restarts_now:
            return False
        self.restarts_now = restarts
        return True

    def begin_start(self) -> None:
        """Count the restarts so far among those of earlier starts."""
        self.restarts_before, self.restarts_now = self.restarts(), {}

    def restarts(self) -> dict[str, int]:
        """Return the number of restarts in the whole run by kind of role; actors are included even with 0."""
        counts = Counter({"actor": 0})
        counts.update(self.restarts_before)
        counts.update(self.restarts_now)
        return dict(counts)

    def statistics(self) -> Fields:
        """Return the averages over finished episodes; empty before the first one."""
        fields: Fields = {}
        if self.averages.mean_return is not None and self.averages.mean_reward is not None:
            fields["mean_return"] = round(self.averages.mean_return, 3)
            fields["average_reward"] = round(self.averages.mean_reward, 4)
        if self._recent:
            fields["recent_success"] = round(self._recent.count(Outcome.SUCCESS) / len(self._recent), 3)
            fields["recent_collision"] = round(self._recent.count(Outcome.COLLISION) / len(self._recent), 3)
        return fields

    def state(self) -> dict[str, Any]:
        """Return the totals as JSON, for `restore`."""
        return {
            "outcomes": {outcome.value: count for outcome, count in self.outcomes.items()},
            "averages": self.averages.state(),
            "sizing": self.sizing.state(),
            "recent": [outcome.value for outcome in self._recent],
            "env_steps": self.env_steps,
            "merges": list(self.merges),
            "restarts": self.restarts(),
        }

    def restore(self, meta: dict[str, Any]) -> None:
        """Restore the totals from a `state`."""
        self.averages.restore(meta["averages"])
        self.sizing.restore(meta["sizing"], sum(meta["outcomes"].values()))
        self._recent = [Outcome(name) for name in meta["recent"]]
        self.outcomes = {Outcome(name): count for name, count in meta["outcomes"].items()}
        self.env_steps = meta["env_steps"]
        self.merges = list(meta["merges"])
        self.restarts_before = meta["restarts"]
