"""What transitions and networks of each level look like; roles that serve any level are told, the actor knows."""

from dataclasses import dataclass

from zsdist.agent import blocks, features
from zsdist.types import Level


@dataclass(frozen=True)
class Shape:
    """What one level's transitions look like: state features and actions."""

    state_size: int
    actions: int


SHAPES = {
    Level.HIGH: Shape(features.HIGH_STATE_SIZE, blocks.HIGH_ACTIONS),
    Level.LOW: Shape(features.LOW_STATE_SIZE, features.LOW_ACTIONS),
}
