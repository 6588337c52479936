"""Jobs of all actors as they were last sent, so that each is encoded once for a change and not for each sending."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from zsdist.roles.scheduler.merge import Drive
from zsdist.roles.scheduler.progress import RunProgress
from zsdist.wire import codec
from zsdist.wire.messages import Jobs


class JobBook:
    """Encoded jobs by actor.

    Args:
        sender_epoch: epoch of the scheduler.
        progress: progress of the run, from which the jobs follow.
    """

    def __init__(self, sender_epoch: int, progress: RunProgress) -> None:
        self._sender_epoch, self._progress = sender_epoch, progress
        self._entries: dict[str, tuple[dict[str, Any], bytes]] = {}

    def renew(self, actors: Iterable[str], drives: Mapping[str, Sequence[Drive]]) -> list[tuple[str, bytes]]:
        """Return the encoded jobs of those of the actors whose jobs have changed.

        The count of finished episodes is part of them, and no reason to send them anew.

        Args:
            actors: actors to look at; those that take no part in the run are told so.
            drives: validation drives of each actor; without an entry it has none.
        """
        progress, renewed = self._progress, []
        for actor in actors:
            jobs = {
                "epoch": progress.epochs.get(actor),
                "leases": progress.leases.held_by(actor),
                "merge": progress.merge.index if progress.merge else 0,
                "drives": [list(drive) for drive in drives.get(actor, ())],
            }
            if actor not in self._entries or self._entries[actor][0] != jobs:
                payload = codec.encode(Jobs(self._sender_epoch, actor, jobs | {"finished": progress.finished}))
                self._entries[actor] = jobs, payload
                renewed.append((actor, payload))
        return renewed

    def payloads(self, actors: Iterable[str]) -> list[tuple[str, bytes]]:
        """Return the encoded jobs of actors that `renew` has looked at."""
        return [(actor, self._entries[actor][1]) for actor in actors]
