"""Recorder of training episodes: the transitions of both levels with their shaped rewards, as finished trajectories."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from zsdist.agent.options import Option
from zsdist.agent.planner import Planner
from zsdist.agent.reward_shaping import Step, progress_m
from zsdist.agent.situation import Situation
from zsdist.planning.rewards import RewardTerms
from zsdist.types import NO_GUIDE, Behaviour, Level, Outcome, Trajectory


@dataclass(frozen=True)
class RecorderSettings:
    """Discounts and rewards that the levels learn from.

    Attributes:
        discounts: gamma of each level.
        literal_reward: whether both levels learn from the paper's sum of terms instead of the shaped rewards.
    """

    discounts: Mapping[Level, float]
    literal_reward: bool


@dataclass
class TrajectoryBuilder:
    """Transitions of one level under one subgoal (low) or one option (high), collected as they happen.

    Attributes:
        level: level whose DQN learns from them.
        discount: gamma.
        weight_version: version of the weights when the episode began; newer ones act as soon as they arrive.
    """

    level: Level
    discount: float
    weight_version: int
    _states: list[np.ndarray] = field(default_factory=list)
    _masks: list[np.ndarray] = field(default_factory=list)
    _actions: list[int] = field(default_factory=list)
    _guides: list[int] = field(default_factory=list)
    _behaviours: list[Behaviour] = field(default_factory=list)
    _rewards: list[float] = field(default_factory=list)

    def act(self, state: np.ndarray, mask: np.ndarray, action: int, guide: int | None, behaviour: Behaviour) -> None:
        """Begin a step with its state and the action chosen there."""
        self._states.append(state)
        self._masks.append(mask)
        self._actions.append(action)
        self._guides.append(NO_GUIDE if guide is None else int(guide))
        self._behaviours.append(behaviour)

    def reward(self, reward: float) -> None:
        """End the step with its reward."""
        self._rewards.append(reward)

    def close(self, state: np.ndarray, mask: np.ndarray, final: bool) -> Trajectory | None:
        """Return the trajectory up to `state`; None if no step has ended.

        Args:
            state: `(D,)` state after the last step.
            mask: `(A,)` bool, actions that may be taken there.
            final: whether `state` is terminal, so that nothing is bootstrapped from it.
        """
        count = len(self._rewards)
        if not count:
            return None
        rewards = np.array(self._rewards, np.float32)
        discounts = np.full(count, self.discount, np.float32)
        successors = np.arange(1, count + 1)
        if self.level is Level.HIGH:
            rewards, discounts = _to_the_end(rewards, self.discount)
            successors = np.full(count, count)
            if final:
                discounts[:] = 0.0
        elif final:
            discounts[-1] = 0.0
        return Trajectory(
            level=self.level,
            states=np.stack([*self._states[:count], state]),
            actions=np.array(self._actions[:count], np.uint8),
            rewards=rewards,
            discounts=discounts,
            successors=successors.astype(np.uint16),
            masks=np.stack([*self._masks[:count], mask]),
            guides=np.array(self._guides[:count], np.int8),
            behaviours=np.array(self._behaviours[:count], np.uint8),
            weight_version=self.weight_version,
        )


class Recorder:
    """Recorder of one training episode.

    Trajectories of the low level end where the subgoal changes, trajectories of the high level where the option ends.

    Args:
        settings: discounts and rewards.
        weight_versions: versions of the networks when the episode begins.
    """

    def __init__(self, settings: RecorderSettings, weight_versions: Mapping[Level, int]) -> None:
        self._settings, self._versions = settings, weight_versions
        self._builders: dict[Level, TrajectoryBuilder] = {}
        self._finished: list[Trajectory] = []

    def start(self, *levels: Level) -> None:
        """Begin a new trajectory of each of the levels."""
        for level in levels:
            self._builders[level] = TrajectoryBuilder(level, self._settings.discounts[level], self._versions[level])

    def act(
        self,
        level: Level,
        state: np.ndarray,
        mask: np.ndarray,
        action: int,
        guide: int | None,
        behaviour: Behaviour,
    ) -> None:
        """Begin a step of a level.

        Args:
            level: level that acts.
            state: `(D,)` state in which it acts.
            mask: `(A,)` bool, actions that may be taken there.
            action: action taken.
            guide: action of the guide policy, to learn from; None: there is none.
            behaviour: policy that chose the action.
        """
        self._builders[level].act(state, mask, action, guide, behaviour)

    def reward(
        self,
        before: Situation,
        after: Situation,
        terms: RewardTerms,
        *,
        outcome: Outcome | None,
        entered: bool,
        option: Option,
        planner: Planner,
    ) -> None:
        """End the step of both levels with its rewards.

        Args:
            before: situation in which the step began.
            after: situation in which it ended.
            terms: paper rewards of the step.
            outcome: outcome of the episode if the step ended it; else None.
            entered: whether it entered the block that the low level was sent to.
            option: option under which it was taken.
            planner: planner that measures the progress on the map after the step.
        """
        if self._settings.literal_reward:
            low = high = terms.total
        else:
            here, there = _index(before), _index(after)
            to_goal_m = progress_m(planner.cost_to_goal(after), here, there)
            to_subgoal_m = progress_m(planner.cost_to_subgoal(after, option), here, there)
            step = Step(
                revisits=int(after.visits[there]) - 1,
                reentries=int(after.block_visits[after.block[::-1]]) - 1 if after.block != before.block else 0,
                gave_way=after.gave_way,
                reached=outcome is Outcome.SUCCESS,
                collided=outcome is Outcome.COLLISION,
            )
            low, high = step.low_reward(to_subgoal_m, entered), step.high_reward(to_goal_m)
        self._builders[Level.LOW].reward(low)
        self._builders[Level.HIGH].reward(high)

    def close(self, level: Level, state: np.ndarray, mask: np.ndarray, final: bool) -> None:
        """End the present trajectory of a level; for the arguments see `TrajectoryBuilder.close`."""
        trajectory = self._builders[level].close(state, mask, final)
        if trajectory is not None:
            self._finished.append(trajectory)

    def drain(self) -> list[Trajectory]:
        """Return the trajectories that were finished since the last call."""
        finished, self._finished = self._finished, []
        return finished


def _to_the_end(rewards: np.ndarray, discount: float) -> tuple[np.ndarray, np.ndarray]:
    """Return discounted sums `sum gamma^t r` from each step to the last, and `gamma^k` over the `k` steps left."""
    sums, factors = np.empty_like(rewards), np.empty_like(rewards)
    total, factor = 0.0, 1.0
    for index in range(len(rewards) - 1, -1, -1):
        total, factor = float(rewards[index]) + discount * total, factor * discount
        sums[index], factors[index] = total, factor
    return sums, factors


def _index(situation: Situation) -> tuple[int, int, int]:
    return situation.state.iy, situation.state.ix, situation.state.heading
