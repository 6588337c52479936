"""Who can be evaluated: a baseline, or a learned policy as it is or with parts of it replaced."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from zsdist.config import Config
from zsdist.dqn import network
from zsdist.evaluation.baselines import BASELINES
from zsdist.evaluation.drivers import Driver, LearnedDriver, Observability, VisualAct
from zsdist.evaluation.oracle_view import by_camera, by_truth
from zsdist.types import Level, Parameters

FULL, HYBRID = "full", "hybrid"


@dataclass(frozen=True)
class Variant:
    """A learned policy of which something is replaced.

    Attributes:
        line: what it is.
        agent: settings of `agent` that differ from the policy's own.
        untrained: levels whose networks are as before training.
        observability: what it is shown.
        shuffled: fields of what it sees whose entries, one a direction, are exchanged by chance at every look.
        exact: whether the car stands exactly where each action should have brought it.
    """

    line: str
    agent: dict[str, Any] = field(default_factory=dict)
    untrained: tuple[Level, ...] = ()
    observability: Observability = Observability.CAMERA
    shuffled: tuple[str, ...] = ()
    exact: bool = False


_PLANNED_HIGH, _PLANNED_LOW = {"high_policy": "planner"}, {"low_policy": "planner"}

VARIANTS: dict[str, Variant] = {
    FULL: Variant("the learned networks under the shield, as the policy's configuration has it"),
    HYBRID: Variant("the learned high level, and A* to its subgoal on the believed map below", _PLANNED_LOW),
    "untrained-high": Variant("the high level's network as before training", untrained=(Level.HIGH,)),
    "untrained-low": Variant("the low level's network as before training", untrained=(Level.LOW,)),
    "untrained": Variant("both networks as before training", untrained=tuple(Level)),
    "shuffled-advice": Variant("the entries of R_p exchanged by chance at every look", shuffled=("advice",)),
    "shuffled-vision": Variant(
        "the same with the rays too: all that vision says of one direction is of another",
        shuffled=("advice", "clearance_m", "dynamic", "ray_probabilities"),
    ),
    "oracle-depth": Variant("vision replaced by true distances in view", observability=Observability.RANGES),
    "oracle-high": Variant("the high level replaced by the planner over blocks on the believed map", _PLANNED_HIGH),
    "oracle-levels": Variant("both levels replaced: the planner over blocks, and A*", _PLANNED_HIGH | _PLANNED_LOW),
    "oracle-motion": Variant("the controller replaced by exact motion from cell to cell", exact=True),
}


@dataclass(frozen=True)
class Contender:
    """Who is evaluated, as data that other processes can be sent.

    Attributes:
        config: grid, camera, vision, agent and reward of the policy.
        parameters: of both networks; None for a baseline.
        baseline: its name in the list; empty for a learned policy.
        variant: of a learned policy, its name in the list.
        shielded: whether a learned policy drives under the shield.
    """

    config: Config
    parameters: dict[Level, Parameters] | None = None
    baseline: str = ""
    variant: str = FULL
    shielded: bool = True

    @property
    def observability(self) -> Observability:
        """What it is shown."""
        return BASELINES[self.baseline].observability if self.baseline else VARIANTS[self.variant].observability

    @property
    def exact(self) -> bool:
        """Whether its car moves exactly."""
        return not self.baseline and VARIANTS[self.variant].exact

    @cached_property
    def settings(self) -> Config:
        """The configuration that it drives under, with what the variant changes."""
        agent = {} if self.baseline else VARIANTS[self.variant].agent
        return self.config.model_copy(update={"agent": self.config.agent.model_copy(update=agent)})

    @cached_property
    def networks(self) -> dict[Level, Parameters] | None:
        """The networks that it drives with, with what the variant changes."""
        if self.parameters is None:
            return None
        fresh = VARIANTS[self.variant].untrained
        return {
            level: untrained(parameters, self.config.seed) if level in fresh else parameters
            for level, parameters in self.parameters.items()
        }

    def driver(self, visual_act: VisualAct | None) -> Driver:
        """A driver of its own; `visual_act` is needed where it sees by the camera."""
        see = by_truth if visual_act is None else by_camera(visual_act)
        if self.baseline:
            return BASELINES[self.baseline].make(self.settings, see)
        shuffled = VARIANTS[self.variant].shuffled
        return LearnedDriver(self.settings, self.networks, see, shielded=self.shielded, shuffled=shuffled)


def untrained(parameters: Parameters, seed: int) -> Parameters:
    """Fresh weights of the same shapes."""
    hidden = [len(value) for name, value in parameters.items() if name.startswith("hidden") and name.endswith(".bias")]
    actions = len(parameters["output.bias"])
    return network.initial_parameters(parameters["hidden0.weight"].shape[1], actions, hidden, seed)
