"""Start of a new run from recorded sets: their transitions are stored as those of an actor that has left.

They take the way of all transitions: they are counted as produced and as stored or rejected, journals and checkpoints
hold them, and learners make updates for them. Actors drive once the learners have made these updates, up to the
limiter's band.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

from zsdist.config import Config
from zsdist.recording.episode import RECORDED
from zsdist.recording.recorded_set import RecordedSet
from zsdist.roles.replay.level_replay import LevelReplay
from zsdist.types import Level, Trajectories
from zsdist.wire.messages import Push

_EPOCH = 0  # of this actor; it never sends anything itself
_LATER_S = 1.0  # after the receipt at 0, so that every acknowledgement is due


def recorded_sets(config: Config) -> list[RecordedSet]:
    """Return the sets that `replay.start_from` names.

    Raises:
        DataError: one is none, or was recorded under another grid, action table, features or rewards.
    """
    found = [RecordedSet(Path(folder)) for folder in config.replay.start_from]
    for each in found:
        each.check(config)
    return found


def trajectories(sets: Sequence[RecordedSet], level: Level, index: int, shards: int) -> Iterable[Trajectories]:
    """Yield the part of a level's transitions that shard `index` of `shards` stores."""
    parts = (part for each in sets for part in each.trajectories(level))
    return (part for number, part in enumerate(parts) if number % shards == index)


def fill(level_replay: LevelReplay, parts: Iterable[Trajectories]) -> None:
    """Store recorded transitions, once: a replay whose journal or checkpoint has them already is left as it is.

    All are in the journal, or none, whenever the process dies.
    """
    if RECORDED in level_replay.inbox.state()["current"]:
        return
    level, sequence, produced = level_replay.level, 0, 0
    level_replay.issue(RECORDED, _EPOCH)
    for part in parts:
        produced += int(part.lengths.sum())
        level_replay.receive(Push(level, RECORDED, _EPOCH, sequence, produced, False, part), b"", 0.0)
        sequence += 1
    level_replay.receive(Push(level, RECORDED, _EPOCH, sequence, produced, True, ()), b"", 0.0)
    level_replay.inbox.acks(_LATER_S, level_replay.credit)  # nobody waits for them
    level_replay.journal.forget()
    level_replay.journal.compact(level_replay.state()[0], level_replay.buffer)
