"""Epsilon-greedy choice of one level; most of its exploratory choices follow a guide policy."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from zsdist.common import finite
from zsdist.dqn import network
from zsdist.types import Behaviour

QFunction = Callable[[np.ndarray], np.ndarray]  # values `(B, A)` of states `(B, D)`


@dataclass(frozen=True)
class Choice:
    """Choice of one level.

    Attributes:
        index: index of the action or of the high level's choice.
        behaviour: policy that chose it.
        changed: whether the mask excluded the choice that the network values most.
        values: `(A,)` values of the network; None where another policy chose.
    """

    index: int
    behaviour: Behaviour
    changed: bool
    values: np.ndarray | None = field(default=None, compare=False)


@dataclass(frozen=True)
class EpsilonGreedy:
    """Exploration rule of both levels in one episode.

    Attributes:
        epsilon: probability of an exploratory choice.
        guide_share: probability that such a choice follows the guide policy, where it has one; else it is uniform.
        rng: generator of the exploration.
    """

    epsilon: float
    guide_share: float
    rng: np.random.Generator

    def choose(
        self, q: QFunction, state: np.ndarray, mask: np.ndarray, *, guided: int | None, instead: int | None
    ) -> Choice:
        """Return the choice of a level.

        Args:
            q: Q-function of the level.
            state: `(D,)` state of the level.
            mask: `(A,)` bool, allowed choices.
            guided: choice of the guide policy; None: it has none.
            instead: choice of the policy that the configuration puts in the network's place; None: the network decides.

        Raises:
            RunError: a value of the network is not finite.
        """
        if instead is not None:
            return Choice(int(instead), Behaviour.GUIDE, False)
        if self.rng.random() < self.epsilon:
            if guided is not None and self.rng.random() < self.guide_share:
                return Choice(int(guided), Behaviour.GUIDE, False)
            return Choice(int(self.rng.choice(np.flatnonzero(mask))), Behaviour.UNIFORM, False)
        values = q(state[None])[0]
        finite.require("values of the network in a state", values)  # the greatest of them would be NaN itself
        best = int(network.greedy(values[None], mask[None])[0])
        return Choice(best, Behaviour.GREEDY, best != int(values.argmax()), values)
