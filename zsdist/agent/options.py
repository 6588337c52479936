"""Options of the high level: each leads towards a neighbouring block or the goal until it ends."""

from dataclasses import dataclass
from enum import StrEnum

from zsdist.agent.blocks import GOAL_CHOICE, Choices
from zsdist.agent.situation import Situation
from zsdist.types import Behaviour


class End(StrEnum):
    """Reason for which an option ended."""

    ENTERED = "entered"
    BLOCKED = "blocked"  # no free path leads into the block any more
    STRAYED = "strayed"  # the option's block is no neighbour of the car's present block
    LONG = "long"  # it took `option_max_steps`


@dataclass(frozen=True)
class Option:
    """Decision of the high level while it is carried out.

    Attributes:
        block: `(bx, by)` of the block to enter; None: the goal is sought.
        subgoal: `(x_m, y_m)` that the low level is sent to.
        behaviour: policy that chose the option.
        steps: number of low-level steps so far.
    """

    block: tuple[int, int] | None
    subgoal: tuple[float, float]
    behaviour: Behaviour
    steps: int = 0

    @classmethod
    def start(cls, options: Choices, choice: int, behaviour: Behaviour) -> "Option":
        """Return the option of a choice."""
        block = None
        if choice != GOAL_CHOICE:
            bx, by = options.blocks[choice]
            block = int(bx), int(by)
        return cls(block, _point(options, choice), behaviour)

    @property
    def seeks_goal(self) -> bool:
        """True if the goal itself is the subgoal."""
        return self.block is None

    def choice(self, options: Choices) -> int | None:
        """Return the index of this option among the present choices; None where it is none of them."""
        return GOAL_CHOICE if self.block is None else options.index_of(self.block)

    def end(self, situation: Situation, options: Choices, max_steps: int) -> End | None:
        """Return the reason for which the option ends here; None: it continues."""
        if self.block is not None:
            if situation.block == self.block:
                return End.ENTERED
            choice = options.index_of(self.block)
            if choice is None:
                return End.STRAYED
            if not options.mask[choice]:
                return End.BLOCKED
        return End.LONG if self.steps >= max_steps else None

    def stepped(self, situation: Situation, options: Choices) -> "Option":
        """Return the option one step later; its subgoal changes only where no free path leads to it any more."""
        subgoal = self.subgoal
        choice = self.choice(options)
        if self.block is not None and choice is not None:
            ix, iy = situation.grid.cell_at(*subgoal)
            if not situation.reachable[iy, ix]:
                subgoal = _point(options, choice)
        return Option(self.block, subgoal, self.behaviour, self.steps + 1)


def _point(options: Choices, choice: int) -> tuple[float, float]:
    x_m, y_m = options.subgoals[choice]
    return float(x_m), float(y_m)
