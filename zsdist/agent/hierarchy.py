"""Algorithm 2 for one car: both levels, the guides and the shield, driven by observations from outside."""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from zsdist.agent import features, guide, reward_shaping, shield
from zsdist.agent.blocks import GOAL_CHOICE, choices
from zsdist.agent.options import End, Option
from zsdist.agent.reward_shaping import TrajectoryBuilder
from zsdist.agent.situation import Situation
from zsdist.config import Config
from zsdist.dqn import network
from zsdist.planning import forward_search
from zsdist.planning.belief import BeliefMap
from zsdist.planning.cost_field import CostField
from zsdist.planning.footprint import successor
from zsdist.planning.grid import HEADINGS, Grid
from zsdist.planning.rewards import RewardTerms
from zsdist.planning.shortest_path import goal_mask
from zsdist.types import Action, Behaviour, Level, Parameters, Pose, Trajectory, View
from zsdist.vision.ray_ablation import ablate_rays

START_DISC_M = 1.5  # about the start, known to be free

QFunctions = dict[Level, Callable[[np.ndarray], np.ndarray]]


def q_functions(parameters: Mapping[Level, Parameters]) -> QFunctions:
    """What `HierarchicalAgent.act` asks, from the weights of both networks."""
    return {level: partial(network.apply, weights) for level, weights in parameters.items()}


@dataclass(frozen=True)
class Decision:
    """What the car is to do now.

    Attributes:
        action: the low-level action.
        behaviour: which policy chose it.
        subgoal: `(x_m, y_m)` the low level is under way to.
        shield_changed: the policy would have done something else without the shield.
        option_started: the high level has just decided.
    """

    action: Action
    behaviour: Behaviour
    subgoal: tuple[float, float]
    shield_changed: bool
    option_started: bool


@dataclass(frozen=True)
class _Choice:
    """One level's choice and what it was made from."""

    index: int
    behaviour: Behaviour
    changed: bool


class HierarchicalAgent:
    """Decides for one car from poses and views, and keeps what there is to learn from it.

    `begin`, then `observe`, `act`, `result` in turn; after the last result `observe` once more, and `finish`.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._grid = Grid.from_config(config.grid)
        self._costs = reward_shaping.way_costs(self._grid)
        self._finished: list[Trajectory] = []

    def begin(
        self,
        pose: Pose,
        goal_xy: tuple[float, float],
        *,
        epsilon: float,
        shielded: bool,
        rng: np.random.Generator,
        weight_versions: dict[Level, int],
        learning: bool = True,
    ) -> None:
        """A new episode.

        Args:
            pose: where the car stands; `START_DISC_M` about it is free.
            goal_xy: metres.
            epsilon: share of exploratory decisions.
            shielded: whether the shield masks actions.
            rng: of the exploration.
            weight_versions: of the networks that act now.
            learning: whether there will be trajectories to drain; without, no guide and no planner is asked, unless
                `agent.high_policy` or `agent.low_policy` puts one in a network's place.
        """
        cells, blocks = self._grid.cells, self._grid.blocks
        self._goal = (float(goal_xy[0]), float(goal_xy[1]))
        self._goals = goal_mask(self._grid, self._goal, self._config.sim.success_radius_m)
        self._to_goal, self._to_subgoal = CostField(self._goals, self._costs), None
        self._epsilon, self._shielded, self._rng = epsilon, shielded, rng
        self._versions, self._learning = weight_versions, learning
        self._belief = BeliefMap(self._grid)
        self._belief.clear_disc(pose.x_m, pose.y_m, START_DISC_M)
        self._visits = np.zeros((cells, cells, HEADINGS), np.int32)
        self._block_visits = np.zeros((blocks, blocks), np.int32)
        self._tries = np.zeros((blocks, blocks), np.int32)
        self._goal_tries = 0
        self._low_guide = guide.LowGuide(self._config.agent)
        self._situation: Situation | None = None
        self._option: Option | None = None
        self._tracks: dict[Level, TrajectoryBuilder] = {}
        self._outcome: tuple[RewardTerms, bool, bool] | None = None
        self._over = False
        self._finished = []
        self._counts: Counter[str] = Counter()

    @property
    def situation(self) -> Situation | None:
        """What the car knew at the last `observe`; None before the first of an episode."""
        return self._situation

    def observe(self, pose: Pose, view: View) -> None:
        """Takes in where the car is and what it sees (lines 6 and 13), and completes the step that led here."""
        before = self._situation
        view = ablate_rays(view, self._config.vision.rays)
        self._belief.update(pose, view, self._config.camera.forward_m)
        self._situation = self._assess(pose, view, before)
        self._options = choices(self._situation)
        self._rooms = features.measure_rooms(self._situation)
        self._low_mask = self._allowed()
        self._low_state = self._high_state = None
        if self._learning or "planner" in (self._config.agent.high_policy, self._config.agent.low_policy):
            self._cost_to_goal = self._to_goal.on(self._situation.blocked)
        if self._outcome is not None:
            self._complete(before)

    def act(self, q: QFunctions) -> Decision:
        """Algorithm 2, lines 6 to 13, at one step.

        The high level sends the low level to a block or to the goal and is asked again when that option has ended;
        the low level acts. With probability epsilon either follows its guide policy or, less often, chance. What
        either is shown to learn from is the shortest believed way, whoever acts.

        Args:
            q: for each level the values `(B, A)` of states `(B, D)`.
        """
        started = self._option is None
        if started:
            self._option = self._decide_option(q[Level.HIGH])
        option, situation = self._option, self._situation

        # Lines 8 to 12: the global policy, potential field or advice, is what exploration follows.
        guided = None
        if self._learning or self._config.agent.low_policy == "planner":
            guided = self._low_guide.action(situation, option.subgoal, self._shield_mask)
        instead = self._instead_of_low(guided)
        choice = self._choose(q[Level.LOW], self._state(Level.LOW), self._low_mask, guided, instead)
        if self._learning:
            shown = self._shortest_way(option, otherwise=guided)
            self._tracks[Level.LOW].act(self._state(Level.LOW), self._low_mask, choice.index, shown, choice.behaviour)
            self._tracks[Level.HIGH].act(
                self._state(Level.HIGH),
                self._options.mask,
                option.choice(self._options),
                self._planned(),
                option.behaviour,
            )
        self._counts["agent_steps"] += 1
        self._counts[f"low_{choice.behaviour.name.lower()}"] += 1
        self._counts["shield_changes"] += choice.changed and self._shielded
        return Decision(
            Action(choice.index), choice.behaviour, option.subgoal, choice.changed and self._shielded, started
        )

    def result(self, terms: RewardTerms, terminated: bool, truncated: bool) -> None:
        """What the environment said of the step; the next `observe` completes it."""
        self._outcome = (terms, terminated, truncated)

    def finish(self) -> None:
        """Ends the episode, here if need be: open trajectories are closed as truncated."""
        if self._option is not None and self._tracks:
            self._close(Level.LOW, final=False)
            self._close(Level.HIGH, final=False)
        self._option, self._tracks, self._outcome = None, {}, None

    def drain(self) -> list[Trajectory]:
        """Trajectories completed since the last call: low ones end where the subgoal moves, high ones with options."""
        finished, self._finished = self._finished, []
        return finished

    def statistics(self) -> dict[str, float]:
        """Plain numbers about the episode so far."""
        names = ("agent_steps", "shield_changes", "shield_gave_way", "shield_forced", "options", "revisits")
        names += tuple(f"options_{end}" for end in End)
        names += tuple(f"{level}_{name.lower()}" for level in Level for name in Behaviour.__members__)
        counts: dict[str, float] = {name: int(self._counts[name]) for name in names}
        guided = self._low_guide.explored + self._low_guide.unexplored
        seen = 0.0
        if self._situation is not None:
            border = self._grid.fine_border
            seen = float(self._situation.seen[border : -border or None, border : -border or None].mean())
        return counts | {
            "explored_share": round(seen, 4),
            "guide_explored_share": round(self._low_guide.explored / guided, 4) if guided else 0.0,
        }

    def _assess(self, pose: Pose, view: View, before: Situation | None) -> Situation:
        state = self._grid.lattice_state(pose)
        block = self._grid.block_of(state.ix, state.iy)
        self._counts["revisits"] += self._visits[state.iy, state.ix, state.heading] > 0
        self._visits[state.iy, state.ix, state.heading] += 1
        if before is None or before.block != block:
            self._block_visits[block[1], block[0]] += 1
        judgement = shield.judge(self._belief, state, self._goals, self._visits)
        self._shield_mask = judgement.allowed
        self._counts["shield_gave_way"] += judgement.gave_way
        self._counts["shield_forced"] += judgement.forced and self._shielded
        return Situation(
            grid=self._grid,
            state=state,
            goal=self._goal,
            goals=self._goals,
            advice=view.advice,
            occupied=self._belief.occupied(),
            seen=self._belief.seen(),
            ways=judgement.ways,
            squeezed=judgement.gave_way,
            drive_m=forward_search.metres_from(judgement.ways.blocked, state, self._costs),
            visits=self._visits,
            block_visits=self._block_visits,
            tries=self._tries,
            goal_tries=self._goal_tries,
        )

    def _allowed(self) -> np.ndarray:
        situation = self._situation
        return self._shield_mask if self._shielded else shield.on_grid(situation.state, self._grid.cells)

    def _decide_option(self, q: Callable[[np.ndarray], np.ndarray]) -> Option:
        guided = self._planned() if self._learning else None
        instead = self._instead_of_high()
        choice = self._choose(q, self._state(Level.HIGH), self._options.mask, guided, instead)
        option = Option.start(self._options, choice.index, choice.behaviour)
        if self._learning:
            for level, settings in ((Level.LOW, self._config.low), (Level.HIGH, self._config.high)):
                self._tracks[level] = TrajectoryBuilder(level, settings.discount, self._versions[level])
        self._low_state = None
        self._counts["options"] += 1
        self._counts[f"high_{choice.behaviour.name.lower()}"] += 1
        return option

    def _choose(
        self,
        q: Callable[[np.ndarray], np.ndarray],
        state: np.ndarray,
        mask: np.ndarray,
        guided: int | None,
        instead: int | None,
    ) -> _Choice:
        """Epsilon-greedy among what is allowed; the exploratory share follows the guide or chance.

        `instead` is what the configuration has decide in the network's place; None: the network decides.
        """
        if instead is not None:
            return _Choice(int(instead), Behaviour.GUIDE, False)
        if self._rng.random() < self._epsilon:
            if guided is not None and self._rng.random() < self._config.agent.guide_share:
                return _Choice(int(guided), Behaviour.GUIDE, False)
            return _Choice(int(self._rng.choice(np.flatnonzero(mask))), Behaviour.UNIFORM, False)
        values = q(state[None])[0]
        best = int(network.greedy(values[None], mask[None])[0])
        return _Choice(best, Behaviour.GREEDY, best != int(values.argmax()))

    def _instead_of_high(self) -> int | None:
        match self._config.agent.high_policy:
            case "planner":
                return self._planned()
            case "goal":
                return GOAL_CHOICE
        return None

    def _instead_of_low(self, guided: Action | None) -> Action | None:
        match self._config.agent.low_policy:
            case "planner":
                return self._shortest_way(self._option, otherwise=guided)
            case "field":
                return self._low_guide.descend(self._situation, self._option.subgoal, self._shield_mask)
        return None

    def _shortest_way(self, option: Option, otherwise: Action | None) -> Action | None:
        """The first action of the shortest believed way to the option's subgoal; `otherwise` where there is none."""
        state, allowed = self._situation.state, self._shield_mask.tolist()
        cost, steps = self._cost_to_subgoal(option), self._costs[state.heading].tolist()
        least, best = math.inf, otherwise
        for action in Action:
            end = successor(state, action)
            if allowed[action] and self._grid.on_grid(end.ix, end.iy):
                total = float(cost[end.iy, end.ix, end.heading]) + steps[action]
                if total < least:
                    least, best = total, action
        return best

    def _cost_to_subgoal(self, option: Option) -> np.ndarray:
        """Metres to the option's subgoal on the believed map, `(cells, cells, 8)`."""
        if option.seeks_goal:
            return self._cost_to_goal
        ix, iy = self._grid.cell_at(*option.subgoal)
        if self._to_subgoal is None or not self._to_subgoal.targets[iy, ix]:
            targets = np.zeros_like(self._goals)
            targets[iy, ix] = True
            self._to_subgoal = CostField(targets, self._costs)
        return self._to_subgoal.on(self._situation.blocked)

    def _planned(self) -> int:
        return guide.high_choice(self._situation, self._options, self._cost_to_goal, self._costs)

    def _state(self, level: Level) -> np.ndarray:
        """This step's features of a level, measured once."""
        if level is Level.HIGH:
            if self._high_state is None:
                self._high_state = features.high_state(self._situation, self._options, self._rooms)
            return self._high_state
        if self._low_state is None:
            option = self._option
            self._low_state = features.low_state(self._situation, option.subgoal, option.seeks_goal, self._rooms)
        return self._low_state

    def _complete(self, before: Situation) -> None:
        """Lines 13 and 14 for the step from `before` to here: rewards, transitions, and whether the option ends."""
        (terms, terminated, truncated), self._outcome = self._outcome, None
        option = self._option
        followed = option.stepped(self._situation, self._options)
        end = followed.end(self._situation, self._options, self._config.agent.option_max_steps)
        over = terminated or truncated
        if self._learning:
            self._reward(before, option, terms, terminated, entered=end is End.ENTERED)
        if over or end is not None:
            self._close(Level.LOW, final=terminated or end is End.ENTERED)
            self._close(Level.HIGH, final=terminated)
            self._option = None
            if end is not None:
                self._count_end(option, end)
        elif followed.subgoal != option.subgoal:
            self._close(Level.LOW, final=False)
            self._option, self._low_state = followed, None
            if self._learning:
                self._tracks[Level.LOW] = TrajectoryBuilder(
                    Level.LOW, self._config.low.discount, self._versions[Level.LOW]
                )
        else:
            self._option = followed

    def _reward(self, before: Situation, option: Option, terms: RewardTerms, terminated: bool, entered: bool) -> None:
        if self._config.reward.literal:
            low = high = terms.total
        else:
            now, here, there = self._situation, _index(before), _index(self._situation)
            reached = terminated and terms.goal == self._config.reward.goal
            collided = terminated and not reached
            to_goal = reward_shaping.progress_m(self._cost_to_goal, here, there)
            to_subgoal = reward_shaping.progress_m(self._cost_to_subgoal(option), here, there)
            step = reward_shaping.Step(
                revisits=int(self._visits[there]) - 1,
                reentries=int(self._block_visits[now.block[::-1]]) - 1 if now.block != before.block else 0,
                squeezed=now.squeezed,
                reached=reached,
                collided=collided,
            )
            low, high = step.low_reward(to_subgoal, entered), step.high_reward(to_goal)
        self._tracks[Level.LOW].reward(low)
        self._tracks[Level.HIGH].reward(high)

    def _close(self, level: Level, final: bool) -> None:
        if not self._learning:
            return
        mask = self._options.mask if level is Level.HIGH else self._low_mask
        trajectory = self._tracks[level].close(self._state(level), mask, final)
        if trajectory is not None:
            self._finished.append(trajectory)

    def _count_end(self, option: Option, end: End) -> None:
        self._counts[f"options_{end}"] += 1
        if end is End.ENTERED:
            return
        if option.block is None:
            self._goal_tries += 1
        else:
            self._tries[option.block[1], option.block[0]] += 1


def _index(situation: Situation) -> tuple[int, int, int]:
    return situation.state.iy, situation.state.ix, situation.state.heading
