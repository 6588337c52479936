"""How a replay is divided among several processes: whose transitions each takes in, and how much of everything it has.

Each shard is a whole replay for its actors: limiter, ring and journal are its own, and so the ratio of updates to
inserts holds in each, and in all of them together. It gets the part of every size that its actors are of all actors;
so it holds as large a part of what is stored as its actors give, and gives as large a part of the batches.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import Self

from zsdist.config import Config
from zsdist.roles.permissions import actor_name

ROLE = "replay"


@dataclass(frozen=True)
class ReplayShard:
    """One of a level's replay processes.

    Attributes:
        index: which, from 0.
        actors: names of those who push to it; None: all there are.
        share: of all sizes that this one has.
    """

    index: int
    actors: frozenset[str] | None
    share: Fraction

    @classmethod
    def of(cls, config: Config, index: int) -> Self:
        """Shard `index` of `replay.shards`; actors are dealt to the shards in turn."""
        shards, actors = config.replay.shards, config.run.actors
        if shards == 1:
            return cls(index, None, Fraction(1))
        mine = range(index, actors, shards)
        return cls(index, frozenset(map(actor_name, mine)), Fraction(len(mine), actors))

    @property
    def name(self) -> str:
        """By which its orders come and its state is kept: the first shard is called as if it were the only one."""
        return state_name(self.index)

    def owns(self, actor: str) -> bool:
        """Whether `actor` pushes to this shard."""
        return self.actors is None or actor in self.actors

    def part(self, total: int) -> int:
        """This shard's part of a size, at least 1."""
        return max(1, round(total * self.share))


def state_name(index: int) -> str:
    """See `ReplayShard.name`."""
    return f"{ROLE}-{index}" if index else ROLE


def state_names(config: Config) -> list[str]:
    """Of all shards."""
    return [state_name(index) for index in range(config.replay.shards)]
