"""Contract of recorded transitions: all that they depend on, so that no learner mixes those of two kinds."""

from typing import Any

from pydantic import BaseModel, ConfigDict

from zsdist.agent import features
from zsdist.config import Config, GridConfig, RewardConfig
from zsdist.errors import DataError
from zsdist.planning.footprint import ADVANCES, TURNS
from zsdist.types import Action, Level

EIGHTH_DEG = 45


class Move(BaseModel):
    """One action of the table: a turn in place, and an advance after it.

    Attributes:
        name: name of the action.
        turn_deg: turn, counter-clockwise, in degrees.
        advance_cells: cells of the grid that the car advances after it.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    turn_deg: int
    advance_cells: int


class TransitionContract(BaseModel):
    """All that states, actions and rewards of recorded transitions depend on.

    Attributes:
        features: `zsdist.agent.features.VERSION`, the meaning of the states.
        state_sizes: number of features by level.
        actions: actions of the low level, in order.
        grid: planning grid.
        success_radius_m: distance from the goal within which it is reached.
        discounts: discount by level.
        literal_reward: the paper's rewards, where levels learn from their sum; None: from the shaped rewards.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    features: int
    state_sizes: dict[str, int]
    actions: tuple[Move, ...]
    grid: GridConfig
    success_radius_m: float
    discounts: dict[str, float]
    literal_reward: RewardConfig | None

    @classmethod
    def of(cls, config: Config) -> "TransitionContract":
        """Return the contract of transitions that are made under a configuration."""
        return cls(
            features=features.VERSION,
            state_sizes={Level.HIGH.value: features.HIGH_STATE_SIZE, Level.LOW.value: features.LOW_STATE_SIZE},
            actions=tuple(
                Move(name=action.name.lower(), turn_deg=EIGHTH_DEG * TURNS[action], advance_cells=ADVANCES[action])
                for action in Action
            ),
            grid=config.grid,
            success_radius_m=config.sim.success_radius_m,
            discounts={Level.HIGH.value: config.high.discount, Level.LOW.value: config.low.discount},
            literal_reward=config.reward if config.reward.literal else None,
        )

    def check(self, what: str, config: Config) -> None:
        """Compare with the contract of a configuration.

        Args:
            what: name of the recorded set, for the message.
            config: configuration of the run that is to learn from it.

        Raises:
            DataError: they differ; the message names the first difference with both values.
        """
        recorded, wanted = (
            flat(self.model_dump(mode="json")),
            flat(TransitionContract.of(config).model_dump(mode="json")),
        )
        for name in [*wanted, *recorded]:
            found, needed = recorded.get(name), wanted.get(name)
            if found != needed:
                raise DataError(
                    f"{what} was recorded with {name} {found} and this run has {needed}; allowed are sets of the same "
                    "grid, actions, features, discounts and rewards: record one with this version and configuration"
                )


def flat(tree: Any, path: str = "") -> dict[str, Any]:
    """Return the leaves of nested dictionaries and lists by their paths."""
    if isinstance(tree, dict):
        items = [(f"{path}.{key}" if path else str(key), value) for key, value in tree.items()]
    elif isinstance(tree, list):
        items = [(f"{path}[{index}]", value) for index, value in enumerate(tree)]
    else:
        return {path: tree}
    return {name: leaf for key, value in items for name, leaf in flat(value, key).items()}
