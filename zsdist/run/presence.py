"""Processes of a run's roles that are there: the scheduler counts on an actor from the time its process answers.

A process waits in a cluster until some machine has room for it. An episode that is leased to an actor without a process
would hold up the next merge and the end of the run.
"""

from collections.abc import Callable, Iterable

from zsdist.run.program import RoleSpec

WAITS_S = 20.0  # time without an answer of a process, which starts in a few seconds, after which watchers are told
WAITS_ON_CLUSTER_S = 8.0  # the same on a cluster, where it may lack room
ABSENT_S = 10.0  # time without an answer after which an interrupted run does not wait for a role


class Presence:
    """Roles whose processes are there, and those that wait for one.

    Args:
        waits_s: time for which a role waits before watchers are told.

    Attributes:
        actors: present incarnation of each actor that is there.
        left: last epoch of each actor that was there and is not.
    """

    def __init__(self, waits_s: float = WAITS_S) -> None:
        self._waits_s = waits_s
        self.actors: list[RoleSpec] = []
        self.left: dict[str, int] = {}
        self._awaited_s: dict[RoleSpec, float] = {}  # incarnations without a process, and since when
        self._told: set[RoleSpec] = set()

    def update(self, role_specs: Iterable[RoleSpec], is_there: Callable[[str], bool], now: float) -> list[str]:
        """Note which roles are there now.

        Args:
            role_specs: newest incarnations of all roles.
            is_there: tells by name whether the process of an incarnation has answered.
            now: time, seconds.

        Returns:
            Names of roles that have been without a process for `waits_s`, once for each incarnation.
        """
        newest = list(role_specs)
        present = [role_spec for role_spec in newest if is_there(role_spec.name)]
        names = {role_spec.name for role_spec in present}
        self.left |= {actor.name: actor.epoch for actor in self.actors if actor.name not in names}
        self.left = {name: epoch for name, epoch in self.left.items() if name not in names}
        self.actors = [role_spec for role_spec in present if role_spec.role == "actor"]
        absent = [role_spec for role_spec in newest if role_spec.name not in names]
        self._awaited_s = {role_spec: self._awaited_s.get(role_spec, now) for role_spec in absent}
        overdue = [role_spec for role_spec, since_s in self._awaited_s.items() if now - since_s >= self._waits_s]
        news = [role_spec.name for role_spec in overdue if role_spec not in self._told]
        self._told = set(overdue)
        return news

    def absent(self, now: float) -> list[str]:
        """Return the names of roles, actors apart, that have been without a process for `ABSENT_S`."""
        long = (role_spec for role_spec, since_s in self._awaited_s.items() if now - since_s >= ABSENT_S)
        return [role_spec.name for role_spec in long if role_spec.role != "actor"]
