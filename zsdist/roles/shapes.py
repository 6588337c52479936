"""Sizes of the transitions of each level, and the initial weights of its network.

Replay and learners know only these sizes; the meaning of features and actions is known to the actor alone.
"""

from dataclasses import dataclass

from zsdist.agent import blocks, features
from zsdist.config import Config, LevelConfig
from zsdist.dqn import network
from zsdist.types import Level, Parameters


@dataclass(frozen=True)
class Shape:
    """Number of state features and of actions in one level's transitions."""

    state_size: int
    actions: int


SHAPES = {
    Level.HIGH: Shape(features.HIGH_STATE_SIZE, blocks.HIGH_ACTIONS),
    Level.LOW: Shape(features.LOW_STATE_SIZE, features.LOW_ACTIONS),
}


def level_settings(config: Config, level: Level) -> LevelConfig:
    """Return the settings of one level."""
    return config.high if level is Level.HIGH else config.low


def learner_seed(config: Config, level: Level) -> int:
    """Return the seed of one level's learner, from which its initial weights follow."""
    return 2 * config.seed + (level is Level.HIGH)


def initial_weights(config: Config, level: Level) -> Parameters:
    """Return the weights that one level's network has before training, in any run of this configuration."""
    shape, hidden = SHAPES[level], level_settings(config, level).hidden
    return network.initial_parameters(shape.state_size, shape.actions, hidden, learner_seed(config, level))
