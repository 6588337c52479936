"""Sizes of the transitions of each level.

Replay and learners know only these sizes; the meaning of features and actions is known to the actor alone.
"""

from dataclasses import dataclass

from zsdist.agent import blocks, features
from zsdist.types import Level


@dataclass(frozen=True)
class Shape:
    """Number of state features and of actions in one level's transitions."""

    state_size: int
    actions: int


SHAPES = {
    Level.HIGH: Shape(features.HIGH_STATE_SIZE, blocks.HIGH_ACTIONS),
    Level.LOW: Shape(features.LOW_STATE_SIZE, features.LOW_ACTIONS),
}
