"""Contenders of an evaluation: baselines, and learned policies as they are or with parts of them replaced."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from zsdist.config import Config
from zsdist.evaluation.baselines import BASELINES
from zsdist.evaluation.drivers import Driver, LearnedDriver, Observability, ViewPredictor
from zsdist.evaluation.oracle_view import by_camera, by_truth
from zsdist.roles.shapes import initial_weights
from zsdist.types import Level, Parameters

FULL, HYBRID = "full", "hybrid"


@dataclass(frozen=True)
class Variant:
    """Learned policy with a part replaced.

    Attributes:
        line: description in one line.
        agent: settings of `agent` that differ from the policy's own.
        untrained: levels whose networks have initial weights, as before training.
        observability: part of its surroundings that the policy observes.
        shuffled: fields of the view whose entries, one per direction, are permuted at random at every observation.
        exact: whether each action ends exactly at the lattice state that it should reach.
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
    "shuffled-advice": Variant("the entries of R_p permuted at random at every observation", shuffled=("advice",)),
    "shuffled-vision": Variant(
        "the same with the rays too: every output of vision is of another direction",
        shuffled=("advice", "clearance_m", "dynamic", "ray_probabilities"),
    ),
    "oracle-depth": Variant("vision replaced by true distances in view", observability=Observability.RANGES),
    "oracle-high": Variant("the high level replaced by the planner over blocks on the believed map", _PLANNED_HIGH),
    "oracle-levels": Variant("both levels replaced: the planner over blocks, and A*", _PLANNED_HIGH | _PLANNED_LOW),
    "oracle-motion": Variant("the controller replaced by exact motion from cell to cell", exact=True),
}


@dataclass(frozen=True)
class Contender:
    """Contender of an evaluation, as data that can be sent to other processes.

    Attributes:
        config: configuration of the policy, before the changes of its variant.
        parameters: weights of both networks; None for a baseline.
        baseline: name in `BASELINES`; empty for a learned policy.
        variant: name in `VARIANTS`, for a learned policy.
        shielded: whether a learned policy drives under the shield.
    """

    config: Config
    parameters: dict[Level, Parameters] | None = None
    baseline: str = ""
    variant: str = FULL
    shielded: bool = True

    @property
    def observability(self) -> Observability:
        """Part of its surroundings that it observes."""
        return BASELINES[self.baseline].observability if self.baseline else VARIANTS[self.variant].observability

    @property
    def exact(self) -> bool:
        """True if each action ends exactly at the lattice state that it should reach."""
        return not self.baseline and VARIANTS[self.variant].exact

    @cached_property
    def settings(self) -> Config:
        """Configuration that it drives under, with the changes of its variant."""
        agent = {} if self.baseline else VARIANTS[self.variant].agent
        return self.config.model_copy(update={"agent": self.config.agent.model_copy(update=agent)})

    @cached_property
    def networks(self) -> dict[Level, Parameters] | None:
        """Networks that it drives with, with the changes of its variant; None for a baseline."""
        if self.parameters is None:
            return None
        fresh = VARIANTS[self.variant].untrained
        return {
            level: initial_weights(self.config, level) if level in fresh else parameters
            for level, parameters in self.parameters.items()
        }

    def driver(self, visual_act: ViewPredictor | None) -> Driver:
        """Return a new driver; `visual_act` is needed if it observes through the camera."""
        see = by_truth if visual_act is None else by_camera(visual_act)
        if self.baseline:
            return BASELINES[self.baseline].make(self.settings, see)
        assert self.networks is not None, "a learned policy has networks"
        shuffled = VARIANTS[self.variant].shuffled
        return LearnedDriver(self.settings, self.networks, see, shielded=self.shielded, shuffled=shuffled)
