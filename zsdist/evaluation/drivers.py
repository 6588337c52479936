"""Drivers of evaluated episodes: their contract, what each may observe, and the driver of a learned policy."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from zsdist.agent.hierarchy import Decision, HierarchicalAgent, q_functions
from zsdist.agent.recorder import Recorder, RecorderSettings
from zsdist.agent.situation import Situation
from zsdist.config import Config
from zsdist.driving.settings import agent_settings
from zsdist.planning.rewards import RewardTerms
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Level, Outcome, Parameters, Pose, Trajectory, View
from zsdist.vision.ray_ablation import ablate_rays

# Views of images `(B, px, px, 3)` for goals at bearings (rad) and distances (m) `(B,)`; see `zsdist.vision.visual_act`.
ViewPredictor = Callable[[np.ndarray, np.ndarray, np.ndarray], Sequence[View]]


class Observability(StrEnum):
    """Part of its surroundings that a driver observes."""

    NOTHING = "pose and goal only"
    CAMERA = "the camera, by the visual-act model"
    RANGES = "true distances within the camera's view"
    MAP = "the whole true map"


@dataclass(frozen=True)
class Observed:
    """Observation on which a driver decides.

    Attributes:
        image: `(px, px, 3)` uint8, camera picture at the true pose; None if no pictures were requested.
        pose: true pose of the car.
        goal: `(x_m, y_m)` of the goal.
        allowed: `(5,)` bool, actions that do not lead off the grid.
        truth: view of a faultless model; None unless the driver observes true distances.
    """

    image: np.ndarray | None
    pose: Pose
    goal: tuple[float, float]
    allowed: np.ndarray
    truth: View | None = None


See = Callable[[Observed], View]  # from an observation to a driver's view


@dataclass(frozen=True)
class Thought:
    """Decision of a hierarchical driver, and the situation in which it was made."""

    situation: Situation
    decision: Decision


class Driver(ABC):
    """Policy that chooses the actions of one car, one episode at a time.

    Attributes:
        shield_changes: number of decisions of this episode that the shield changed.
        thought: decision behind the last action and its situation; None for a driver without them.
    """

    shield_changes = 0
    thought: Thought | None = None

    @abstractmethod
    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """Begin an episode; `truth` is given to drivers that observe the whole true map, and to no other."""

    @abstractmethod
    def act(self, observed: Observed) -> int:
        """Return the next action."""

    def result(self, terms: RewardTerms, outcome: Outcome | None) -> None:  # noqa: B027 (most learn nothing)
        """Report the rewards of the action, and the outcome if it ended the episode."""

    def record(self, settings: RecorderSettings) -> bool:
        """Record the transitions of all episodes that begin from now on; return whether the driver makes any."""
        return False

    def drain(self, last: Observed | None = None) -> list[Trajectory]:
        """Return the trajectories recorded since the last call.

        Args:
            last: observation in which the episode has ended, which completes its last ones; None: it goes on.
        """
        return []


class LearnedDriver(Driver):
    """Greedy policy of both networks: argmax only, and the shield may only mask.

    Args:
        config: configuration to drive under; `agent.high_policy` and `agent.low_policy` may put planners in place of
            the networks.
        parameters: weights of both networks.
        see: function from an observation to a view.
        shielded: whether the shield masks actions.
        shuffled: fields of the `View` whose entries, one per direction, are permuted at random at every observation.
    """

    def __init__(
        self,
        config: Config,
        parameters: Mapping[Level, Parameters],
        see: See,
        *,
        shielded: bool = True,
        shuffled: Sequence[str] = (),
    ) -> None:
        self._agent = HierarchicalAgent(agent_settings(config))
        self._see, self._rays, self._shielded, self._shuffled = see, config.vision.rays, shielded, shuffled
        self._q = q_functions(parameters)
        self._recorded: RecorderSettings | None = None
        self._recorder: Recorder | None = None

    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """Start the agent without exploration, and without a recorder unless `record` was called."""
        self.shield_changes, self._rng = 0, rng
        self._recorder = Recorder(self._recorded, dict.fromkeys(Level, 0)) if self._recorded else None
        self._agent.begin(pose, goal, epsilon=0.0, shielded=self._shielded, rng=rng, recorder=self._recorder)

    def act(self, observed: Observed) -> int:
        """Observe, and return the best action of Q_low under the best subgoal of Q_high."""
        self._agent.observe(observed.pose, self._view(observed))
        decision = self._agent.act(self._q)
        self.thought = Thought(self._agent.situation, decision)
        self.shield_changes += bool(decision.shield_changed)
        return int(decision.action)

    def result(self, terms: RewardTerms, outcome: Outcome | None) -> None:
        """Report the outcome to the agent, whose options end with the episode."""
        self._agent.result(terms, outcome)

    def record(self, settings: RecorderSettings) -> bool:
        """Record the transitions of both levels; the decisions stay the same."""
        self._recorded = settings
        return True

    def drain(self, last: Observed | None = None) -> list[Trajectory]:
        """Return what the recorder has finished; the last observation is added to the agent's memory."""
        if self._recorder is None:
            return []
        if last is not None:
            self._agent.observe(last.pose, self._view(last))
            self._agent.finish()
        return self._recorder.drain()

    def _view(self, observed: Observed) -> View:
        """Return the view that reaches the agent: fields shuffled first, then limited as `vision.rays` says.

        The order matters: with `three`, rays are made from clearances, which may have been shuffled.
        """
        view = self._see(observed)
        view = replace(view, **{name: self._rng.permutation(getattr(view, name)) for name in self._shuffled})
        return ablate_rays(view, self._rays)
