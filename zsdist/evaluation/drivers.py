"""Who drives an evaluated episode: the contract of a driver, what it may see, and the learned policy under it."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from zsdist.agent.hierarchy import Decision, HierarchicalAgent, q_functions
from zsdist.agent.situation import Situation
from zsdist.config import Config
from zsdist.planning.rewards import RewardTerms
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Level, Parameters, Pose, View

VisualAct = Callable[[np.ndarray, np.ndarray, np.ndarray], Sequence[View]]


class Observability(StrEnum):
    """What a driver learns of its surroundings."""

    NOTHING = "pose and goal only"
    CAMERA = "the camera, by the visual-act model"
    RANGES = "true distances within the camera's view"
    MAP = "the whole true map"


@dataclass(frozen=True)
class Observed:
    """What a driver decides on.

    Attributes:
        image: `(px, px, 3)` uint8, of the camera at the true pose; None where nobody asked for pictures.
        pose: the true pose.
        goal: `(x_m, y_m)`.
        allowed: `(5,)` bool, actions that do not lead off the grid.
        truth: what a faultless model would say of the image; None unless it sees true distances.
    """

    image: np.ndarray | None
    pose: Pose
    goal: tuple[float, float]
    allowed: np.ndarray
    truth: View | None = None


See = Callable[[Observed], View]  # how a driver comes by its view


@dataclass(frozen=True)
class Thought:
    """What a hierarchical driver decided, and what it knew when it did."""

    situation: Situation
    decision: Decision


class Driver(ABC):
    """Chooses the actions of one car, an episode at a time.

    Attributes:
        shield_changes: decisions of this episode in which the shield masked what would have been chosen.
        thought: behind the last action; None where the driver has none to show.
    """

    shield_changes = 0
    thought: Thought | None = None

    @abstractmethod
    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """A new episode; `truth` is given to drivers that see the whole true map, and to no other."""

    @abstractmethod
    def act(self, observed: Observed) -> int:
        """The next action."""

    def result(self, terms: RewardTerms, terminated: bool, truncated: bool) -> None:  # noqa: B027 (most learn nothing)
        """How the action went."""


class LearnedDriver(Driver):
    """The greedy policy of both networks: argmax only, and the shield may only mask.

    Args:
        config: of grid, agent and vision; `agent.high_policy` and `agent.low_policy` may put planners in the networks'
            places.
        parameters: of both networks.
        see: how it comes by its view.
        shielded: whether the shield masks.
        shuffled: fields of the `View` whose entries, one a direction, are exchanged by chance at every look.
    """

    def __init__(
        self,
        config: Config,
        parameters: dict[Level, Parameters],
        see: See,
        *,
        shielded: bool = True,
        shuffled: Sequence[str] = (),
    ) -> None:
        self._agent = HierarchicalAgent(config)
        self._see, self._shielded, self._shuffled = see, shielded, shuffled
        self._q = q_functions(parameters)

    def begin(self, pose: Pose, goal: tuple[float, float], truth: Scene | None, rng: np.random.Generator) -> None:
        """Starts the agent without exploration."""
        self.shield_changes, self._rng = 0, rng
        versions = dict.fromkeys(Level, 0)
        self._agent.begin(
            pose, goal, epsilon=0.0, shielded=self._shielded, rng=rng, weight_versions=versions, learning=False
        )

    def act(self, observed: Observed) -> int:
        """Looks, then takes the best action of Q_low under the best subgoal of Q_high."""
        view = self._see(observed)
        view = replace(view, **{name: self._rng.permutation(getattr(view, name)) for name in self._shuffled})
        self._agent.observe(observed.pose, view)
        decision = self._agent.act(self._q)
        self.thought = Thought(self._agent.situation, decision)
        self.shield_changes += bool(decision.shield_changed)
        return int(decision.action)

    def result(self, terms: RewardTerms, terminated: bool, truncated: bool) -> None:
        """Tells the agent, whose options end with the episode."""
        self._agent.result(terms, terminated, truncated)
