"""Algorithm 2 for one car: decisions of both levels under the shield, from given poses and views."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from zsdist.agent import shield
from zsdist.agent.blocks import GOAL_CHOICE, Choices, choices
from zsdist.agent.epsilon_greedy import Choice, EpsilonGreedy, QFunction
from zsdist.agent.features import StepFeatures
from zsdist.agent.guide import LowGuide
from zsdist.agent.memory import EpisodeMemory
from zsdist.agent.options import End, Option
from zsdist.agent.planner import Planner
from zsdist.agent.recorder import Recorder
from zsdist.agent.shield import Judgement
from zsdist.agent.situation import Situation
from zsdist.config import AgentConfig
from zsdist.dqn import network
from zsdist.planning.belief import BeliefMap
from zsdist.planning.grid import Grid
from zsdist.planning.rewards import RewardTerms
from zsdist.types import Action, Behaviour, Level, Outcome, Parameters, Pose, View

QFunctions = dict[Level, QFunction]

_COUNTED = (
    *("agent_steps", "shield_changes", "shield_gave_way", "shield_forced", "options", "revisits"),
    *(f"options_{end}" for end in End),
    *(f"{level}_{name.lower()}" for level in Level for name in Behaviour.__members__),
)


def q_functions(parameters: Mapping[Level, Parameters]) -> QFunctions:
    """Return the Q-functions for `HierarchicalAgent.act`, made of the weights of both networks."""
    return {level: partial(network.apply, weights) for level, weights in parameters.items()}


@dataclass(frozen=True)
class AgentSettings:
    """Settings of an agent.

    Attributes:
        grid: planning grid.
        success_radius_m: distance from the goal within which it is reached.
        camera_forward_m: distance of the camera ahead of the car's centre.
        policy: the configuration's section `agent`.
    """

    grid: Grid
    success_radius_m: float
    camera_forward_m: float
    policy: AgentConfig


@dataclass(frozen=True)
class Decision:
    """Decision of one step.

    Attributes:
        action: action of the low level.
        behaviour: policy that chose the action.
        subgoal: `(x_m, y_m)` that the low level is sent to.
        shield_changed: whether the action would be another one without the shield.
        option_started: whether the high level has just decided.
        masks: choices that each level may make, `(A,)` bool.
        values: values by the network of each level that decided now, `(A,)`; no entry where another policy chose.
        stuck: whether every action would hit something on the believed map, so that a turn in place is tried.
    """

    action: Action
    behaviour: Behaviour
    subgoal: tuple[float, float]
    shield_changed: bool
    option_started: bool
    masks: dict[Level, np.ndarray] = field(compare=False)
    values: dict[Level, np.ndarray] = field(compare=False)
    stuck: bool


@dataclass(frozen=True)
class _Present:
    """Knowledge and choices at one step.

    Attributes:
        situation: knowledge of the car.
        judgement: judgement of the shield.
        options: choices of the high level.
        low_mask: `(5,)` bool, actions that the low level may take.
        features: states of both levels.
    """

    situation: Situation
    judgement: Judgement
    options: Choices
    low_mask: np.ndarray
    features: StepFeatures


class HierarchicalAgent:
    """Agent of two levels that decides for one car, one episode at a time.

    The calls of an episode are `begin`, then `observe`, `act` and `result` in turn, and after the last result
    `observe` and `finish`.
    """

    def __init__(self, settings: AgentSettings) -> None:
        self._settings, self._policy, self._grid = settings, settings.policy, settings.grid

    def begin(
        self,
        pose: Pose,
        goal_xy: tuple[float, float],
        *,
        epsilon: float,
        shielded: bool,
        rng: np.random.Generator,
        recorder: Recorder | None = None,
        belief: BeliefMap | None = None,
    ) -> None:
        """Begin an episode.

        Args:
            pose: pose at the start; the ground around it counts as free.
            goal_xy: `(x_m, y_m)` of the goal.
            epsilon: probability of an exploratory decision.
            shielded: whether the shield masks actions.
            rng: generator of the exploration.
            recorder: recorder of a training episode; None: nothing is learned from it. Without one, guide policies and
                planner are used only if `agent.high_policy` or `agent.low_policy` puts them in place of a network.
            belief: map to go on with; None: an empty one, on which the ground around the start is free.
        """
        goal = (float(goal_xy[0]), float(goal_xy[1]))
        self._memory = EpisodeMemory(
            self._grid, pose, goal, self._settings.success_radius_m, self._settings.camera_forward_m, belief
        )
        self._planner = Planner(self._grid, self._memory.goals)
        self._guide = LowGuide(self._policy)
        self._rule = EpsilonGreedy(epsilon, self._policy.guide_share, rng)
        self._shielded, self._recorder = shielded, recorder
        self._now: _Present | None = None
        self._option: Option | None = None
        self._result: tuple[RewardTerms, Outcome | None] | None = None
        self._counts: Counter[str] = Counter()

    @property
    def situation(self) -> Situation:
        """Situation at the last `observe` of the episode."""
        return self._present().situation

    @property
    def belief(self) -> BeliefMap:
        """Believed map of the episode."""
        return self._memory.belief

    @property
    def high_choices(self) -> Choices:
        """Choices of the high level at the last `observe` of the episode."""
        return self._present().options

    def high_values(self, q: QFunction) -> np.ndarray:
        """Return the value of each choice of the high level at the last `observe`, `(9,)`; nothing is decided."""
        values: np.ndarray = np.asarray(q(self._present().features.high()[None]))[0]
        return values

    def observe(self, pose: Pose, view: View) -> None:
        """Add a pose and the view from there to the memory (lines 6 and 13), and complete the step that led there."""
        before = self._now
        situation, judgement = self._memory.observe(pose, view)
        self._counts["shield_gave_way"] += judgement.gave_way
        self._counts["shield_forced"] += judgement.forced and self._shielded
        options = choices(situation)
        mask = judgement.allowed if self._shielded else shield.on_grid(situation.state, self._grid.cells)
        self._now = _Present(situation, judgement, options, mask, StepFeatures(situation, options))
        if before is not None and self._result is not None:
            self._complete(before.situation, self._now, *self._result)

    def act(self, q: QFunctions) -> Decision:
        """Decide one step of Algorithm 2, lines 6 to 13.

        The high level sends the low level to a block or to the goal, and decides again when that option has ended. The
        low level chooses an action. With probability epsilon, a level follows its guide policy or, less often, chooses
        uniformly. A recorder stores the planner's choices as those to learn from, whichever policy acted.

        Args:
            q: Q-function of each level.
        """
        now = self._present()
        started = self._option is None
        values: dict[Level, np.ndarray] = {}
        option = self._decide_option(now, q[Level.HIGH], values) if self._option is None else self._option
        self._option = option

        # Lines 8 to 12: exploration follows the global policy, which is advice or potential field.
        guided = None
        if self._recorder is not None or self._policy.low_policy == "planner":
            guided = self._guide.action(now.situation, option.subgoal, now.judgement.allowed)
        instead = self._instead_of_low(now, option, guided)
        choice = self._rule.choose(q[Level.LOW], now.features.low(option), now.low_mask, guided=guided, instead=instead)
        if self._recorder is not None:
            self._record(self._recorder, now, option, choice, guided)
        shield_changed = choice.changed and self._shielded
        self._counts["agent_steps"] += 1
        self._counts[f"low_{choice.behaviour.name.lower()}"] += 1
        self._counts["shield_changes"] += shield_changed
        if choice.values is not None:
            values[Level.LOW] = choice.values
        return Decision(
            action=Action(choice.index),
            behaviour=choice.behaviour,
            subgoal=option.subgoal,
            shield_changed=shield_changed,
            option_started=started,
            masks={Level.HIGH: now.options.mask, Level.LOW: now.low_mask},
            values=values,
            stuck=now.judgement.stuck,
        )

    def result(self, terms: RewardTerms, outcome: Outcome | None) -> None:
        """Store the rewards of a step and the outcome if it ended the episode; the next `observe` completes it."""
        self._result = (terms, outcome)

    def finish(self) -> None:
        """End the episode, which need not be over; open trajectories are closed as truncated."""
        if self._option is not None:
            self._close(self._present(), self._option, low_final=False, high_final=False)
        self._option = self._recorder = self._result = None

    def statistics(self) -> dict[str, float]:
        """Return counts and shares of the episode so far, by name."""
        counts: dict[str, float] = {name: int(self._counts[name]) for name in _COUNTED}
        counts["revisits"] = self._memory.revisits
        guided = self._guide.explored + self._guide.unexplored
        seen = 0.0
        if self._now is not None:
            border = self._grid.fine_border
            seen = float(self._now.situation.seen[border : -border or None, border : -border or None].mean())
        return counts | {
            "explored_share": round(seen, 4),
            "guide_explored_share": round(self._guide.explored / guided, 4) if guided else 0.0,
        }

    def _present(self) -> _Present:
        assert self._now is not None, "observe comes first in an episode"
        return self._now

    def _decide_option(self, now: _Present, q: QFunction, values: dict[Level, np.ndarray]) -> Option:
        guided = None if self._recorder is None else self._planner.high_choice(now.situation, now.options)
        instead = self._instead_of_high(now)
        choice = self._rule.choose(q, now.features.high(), now.options.mask, guided=guided, instead=instead)
        if self._recorder is not None:
            self._recorder.start(*Level)
        self._counts["options"] += 1
        self._counts[f"high_{choice.behaviour.name.lower()}"] += 1
        if choice.values is not None:
            values[Level.HIGH] = choice.values
        return Option.start(now.options, choice.index, choice.behaviour)

    def _instead_of_high(self, now: _Present) -> int | None:
        match self._policy.high_policy:
            case "planner":
                return self._planner.high_choice(now.situation, now.options)
            case "goal":
                return GOAL_CHOICE
        return None

    def _instead_of_low(self, now: _Present, option: Option, guided: Action | None) -> Action | None:
        match self._policy.low_policy:
            case "planner":
                return self._planner.low_action(now.situation, option, now.judgement.allowed, otherwise=guided)
            case "field":
                return self._guide.descend(now.situation, option.subgoal, now.judgement.allowed)
        return None

    def _record(self, recorder: Recorder, now: _Present, option: Option, choice: Choice, guided: Action | None) -> None:
        """Record the beginning of a step, with the planner's choices as the guide's."""
        shown = self._planner.low_action(now.situation, option, now.judgement.allowed, otherwise=guided)
        recorder.act(Level.LOW, now.features.low(option), now.low_mask, choice.index, shown, choice.behaviour)
        high = option.choice(now.options)
        assert high is not None, "an option ends where it is no choice any more"
        planned = self._planner.high_choice(now.situation, now.options)
        recorder.act(Level.HIGH, now.features.high(), now.options.mask, high, planned, option.behaviour)

    def _complete(self, before: Situation, now: _Present, terms: RewardTerms, outcome: Outcome | None) -> None:
        """Complete the step from `before` to `now` (lines 13 and 14): rewards, transitions, end of the option.

        An option that failed is counted before the trajectories are closed: the state in which they end is the one in
        which the high level decides next.
        """
        self._result = None
        option = self._option
        assert option is not None, "a step is taken under an option"
        followed = option.stepped(now.situation, now.options)
        end = followed.end(now.situation, now.options, self._policy.option_max_steps)
        entered = end is End.ENTERED
        if self._recorder is not None:
            self._recorder.reward(
                before,
                now.situation,
                terms,
                outcome=outcome,
                entered=entered,
                option=option,
                planner=self._planner,
            )
        if end is not None:
            self._counts[f"options_{end}"] += 1
            if not entered:
                self._memory.tries.count(option.block)
        if outcome is not None or end is not None:
            terminated = outcome in (Outcome.SUCCESS, Outcome.COLLISION)
            self._close(now, option, low_final=terminated or entered, high_final=terminated)
            self._option = None
            return
        self._option = followed
        if self._recorder is not None and followed.subgoal != option.subgoal:
            self._recorder.close(Level.LOW, now.features.low(option), now.low_mask, final=False)
            self._recorder.start(Level.LOW)

    def _close(self, now: _Present, option: Option, *, low_final: bool, high_final: bool) -> None:
        """End the trajectories of both levels."""
        if self._recorder is not None:
            self._recorder.close(Level.LOW, now.features.low(option), now.low_mask, low_final)
            self._recorder.close(Level.HIGH, now.features.high(), now.options.mask, high_final)
