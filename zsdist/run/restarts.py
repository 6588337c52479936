"""Replacement of roles whose process died or stopped, as decisions without processes or clocks."""

from collections import Counter, deque
from collections.abc import Callable, Iterable

from zsdist.errors import RunError
from zsdist.roles.replay import shards
from zsdist.run.program import RoleSpec

RESTARTED = ("actor", shards.ROLE, "hub", "learner", "scheduler")  # their successors find all that counts
RESTARTS_ALLOWED = 20  # restarts of one role within `WINDOW_S`
WINDOW_S = 600.0
EARLY_S = 3.0  # a role that dies sooner after its start, or before it has published anything, has done nothing
EARLY_DEATHS = 3  # such deaths in a row
BACKOFF_S = 1.0  # least time before a standby that died is replaced; doubles with each death
BACKOFF_MAX_S = 60.0


class Restarts:
    """Roles of a run by name, with the newest incarnation of each, and the count of their restarts.

    Restarts count against a role for `WINDOW_S` only, so that a run of any length may have any number of them.

    Args:
        role_specs: first incarnations of all roles.
        issue_epoch: function that returns a new epoch.
    """

    def __init__(self, role_specs: Iterable[RoleSpec], issue_epoch: Callable[[], int]) -> None:
        self.role_specs = {role_spec.name: role_spec for role_spec in role_specs}
        self._issue_epoch = issue_epoch
        self._counts: Counter[str] = Counter()
        self._recent: dict[str, deque[float]] = {name: deque() for name in self.role_specs}
        self._early: Counter[str] = Counter()  # early deaths in a row
        self._started_s: dict[str, float] = {}
        self._heard: set[str] = set()

    def may_replace(self, name: str) -> bool:
        """Return whether a role is replaced when its process dies; else its death ends the run."""
        return self.role_specs[name].role in RESTARTED

    def note_start(self, name: str, now: float) -> None:
        """Note that the newest incarnation of a role has been started."""
        self._started_s[name] = now
        self._heard.discard(name)

    def note_sign(self, name: str) -> None:
        """Note that the newest incarnation of a role has published something, so that it works."""
        self._heard.add(name)

    def replace(self, name: str, reason: str, now: float) -> RoleSpec:
        """Return the next incarnation of a role.

        Args:
            name: name of the role.
            reason: reason of its death, in one line.
            now: time, seconds.

        Raises:
            RunError: it has been restarted as often as is allowed, or it dies each time at once.
        """
        recent, restarts = self._recent[name], self._counts[name]
        while recent and recent[0] <= now - WINDOW_S:
            recent.popleft()
        lived = name in self._heard and now - self._started_s.get(name, now) >= EARLY_S
        self._early[name] = 0 if lived else self._early[name] + 1
        if self._early[name] >= EARLY_DEATHS:
            raise RunError(f"{reason}; it had been restarted {restarts} times, and died {EARLY_DEATHS} times at once")
        if len(recent) >= RESTARTS_ALLOWED:
            raise RunError(
                f"{reason}; it had been restarted {RESTARTS_ALLOWED} times within {now - recent[0]:.0f} s; allowed are "
                f"as many within {WINDOW_S:.0f} s"
            )
        recent.append(now)
        self._counts[name] += 1
        old = self.role_specs[name]
        self.role_specs[name] = RoleSpec(old.role, old.id, self._issue_epoch())
        return self.role_specs[name]

    def by_kind(self) -> dict[str, int]:
        """Return the number of restarts so far, by kind of role."""
        counts: Counter[str] = Counter()
        for name, count in self._counts.items():
            counts[self.role_specs[name].role] += count
        return dict(counts)


class StandbyPace:
    """Pace at which standby processes are started: the more of them die in a row, the slower."""

    def __init__(self) -> None:
        self.due_s = 0.0  # time before which none is started
        self._deaths = 0

    def delay(self, until_s: float) -> None:
        """Start none before a time, since a core is needed for something else."""
        self.due_s = max(self.due_s, until_s)

    def note_use(self) -> None:
        """Note that a standby took the place of a role."""
        self._deaths = 0

    def note_death(self, now: float) -> None:
        """Note that a standby died while it waited."""
        self.delay(now + min(BACKOFF_S * 2**self._deaths, BACKOFF_MAX_S))
        self._deaths = min(self._deaths + 1, 16)
