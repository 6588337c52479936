"""Epsilon-greedy choice of one level among what is allowed, with a guide in place of most of the random choices."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from zsdist.dqn import network
from zsdist.types import Behaviour

QFunction = Callable[[np.ndarray], np.ndarray]  # values `(B, A)` of states `(B, D)`


@dataclass(frozen=True)
class Choice:
    """Choice of one level.

    Attributes:
        index: of the action or option.
        behaviour: policy that chose it.
        changed: whether the mask excluded what the network values most.
    """

    index: int
    behaviour: Behaviour
    changed: bool


@dataclass(frozen=True)
class EpsilonGreedy:
    """Rule by which both levels choose in one episode.

    Attributes:
        epsilon: share of exploratory choices.
        guide_share: share of these that follow the guide, where there is one; the others are uniform.
        rng: of the exploration.
    """

    epsilon: float
    guide_share: float
    rng: np.random.Generator

    def choose(
        self, q: QFunction, state: np.ndarray, mask: np.ndarray, *, guided: int | None, instead: int | None
    ) -> Choice:
        """Return the choice of a level.

        Args:
            q: values of the level.
            state: `(D,)` of the level.
            mask: `(A,)` bool, what is allowed.
            guided: choice of the guide; None: there is none.
            instead: choice of what the configuration puts in the network's place; None: the network decides.
        """
        if instead is not None:
            return Choice(int(instead), Behaviour.GUIDE, False)
        if self.rng.random() < self.epsilon:
            if guided is not None and self.rng.random() < self.guide_share:
                return Choice(int(guided), Behaviour.GUIDE, False)
            return Choice(int(self.rng.choice(np.flatnonzero(mask))), Behaviour.UNIFORM, False)
        values = q(state[None])[0]
        best = int(network.greedy(values[None], mask[None])[0])
        return Choice(best, Behaviour.GREEDY, best != int(values.argmax()))
