"""Replacement of roles whose process died, as decisions without processes."""

from collections import Counter
from collections.abc import Callable, Iterable

from zsdist.errors import RunError
from zsdist.roles.replay import shards
from zsdist.run.program import RoleSpec

RESTARTED = ("actor", shards.ROLE, "hub", "scheduler")  # kinds of roles whose death loses nothing that counts
RESTARTS_ALLOWED = 20  # restarts of one role before the run is given up


class Restarts:
    """Roles of a run by name, with the newest incarnation of each, and the count of their restarts.

    Args:
        role_specs: first incarnations of all roles.
        issue_epoch: function that returns a new epoch.
    """

    def __init__(self, role_specs: Iterable[RoleSpec], issue_epoch: Callable[[], int]) -> None:
        self.role_specs = {role_spec.name: role_spec for role_spec in role_specs}
        self._issue_epoch = issue_epoch
        self._counts: Counter[str] = Counter()

    def may_replace(self, name: str) -> bool:
        """Return whether a role is replaced when its process dies; else its death ends the run."""
        return self.role_specs[name].role in RESTARTED

    def replace(self, name: str, reason: str) -> RoleSpec:
        """Return the next incarnation of a role.

        Args:
            name: name of the role.
            reason: reason of its death, in one line.

        Raises:
            RunError: it has been restarted as often as is allowed.
        """
        self._counts[name] += 1
        if self._counts[name] > RESTARTS_ALLOWED:
            raise RunError(f"{reason}; it had been restarted {RESTARTS_ALLOWED} times")
        old = self.role_specs[name]
        self.role_specs[name] = RoleSpec(old.role, old.id, self._issue_epoch())
        return self.role_specs[name]

    def by_kind(self) -> dict[str, int]:
        """Return the number of restarts so far, by kind of role."""
        counts: Counter[str] = Counter()
        for name, count in self._counts.items():
            counts[self.role_specs[name].role] += count
        return dict(counts)
