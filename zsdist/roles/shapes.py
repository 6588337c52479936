"""Sizes of the transitions of each level.

The roles that serve any level are given these; only the actor knows what the features and actions mean.
"""

from dataclasses import dataclass

from zsdist.agent import blocks, features
from zsdist.types import Level


@dataclass(frozen=True)
class Shape:
    """Sizes of one level's transitions: state features and actions."""

    state_size: int
    actions: int


SHAPES = {
    Level.HIGH: Shape(features.HIGH_STATE_SIZE, blocks.HIGH_ACTIONS),
    Level.LOW: Shape(features.LOW_STATE_SIZE, features.LOW_ACTIONS),
}
