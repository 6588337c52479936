"""Division of the replay among several processes: the actors that push to each, and its part of every size.

Each shard is a whole replay for its actors, with limiter, ring and journal of its own. The ratio of updates to inserts
thus holds in each shard, and in all of them together. A shard gets the same share of every size as it has of all
actors. It thus stores, and gives in batches, the share of transitions that its actors produce.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import Self

from zsdist.config import Config
from zsdist.roles.permissions import actor_name, actor_number, is_actor_name

ROLE = "replay"


@dataclass(frozen=True)
class ReplayShard:
    """One of the replay's processes.

    Attributes:
        index: number of the shard, from 0.
        actors: names of the run's own actors that push to it; None: all actors, also those that join later.
        share: part of all sizes that this shard has.
        shards: number of all shards.
    """

    index: int
    actors: frozenset[str] | None
    share: Fraction
    shards: int

    @classmethod
    def of(cls, config: Config, index: int) -> Self:
        """Return shard `index` of `replay.shards`; actors are dealt to the shards in turn."""
        shards, actors = config.replay.shards, config.run.actors
        if shards == 1:
            return cls(index, None, Fraction(1), 1)
        mine = range(index, actors, shards)
        return cls(index, frozenset(map(actor_name, mine)), Fraction(len(mine), actors), shards)

    @property
    def name(self) -> str:
        """Name of the shard on keys and in checkpoints: the first one is named as if it were the only one."""
        return state_name(self.index)

    def owns(self, actor: str) -> bool:
        """Return whether `actor` pushes to this shard: actors that join later are dealt to the shards in turn too."""
        if self.actors is None or actor in self.actors:
            return True
        return is_actor_name(actor) and actor_number(actor) % self.shards == self.index

    def part(self, total: int) -> int:
        """Return this shard's part of a size, at least 1."""
        return max(1, round(total * self.share))


def state_name(index: int) -> str:
    """Return the name of shard `index` (`ReplayShard.name`)."""
    return f"{ROLE}-{index}" if index else ROLE


def state_names(config: Config) -> list[str]:
    """Return the names of all shards."""
    return [state_name(index) for index in range(config.replay.shards)]


def is_state_name(name: str) -> bool:
    """Return whether `name` is the name of a shard."""
    return name.partition("-")[0] == ROLE
