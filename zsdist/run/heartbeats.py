"""Watch over the heartbeats of a run's roles: which of them has stopped, as decisions without processes or clocks.

A role publishes statistics twice a second. One that is silent may be busy with a long step, so silence alone is no
proof. Where its process can be seen, it counts as stopped if the process is stopped by a signal, or if the thread of
the role has neither computed nor been woken for a while. A role that computes is never replaced, nor one that waits
for a processor on a busy machine.
"""

from collections.abc import Callable
from dataclasses import dataclass

SILENT_S = 2.0  # silence after which a process is looked at
STOPPED_S = 3.0  # silence after which a process that is stopped by a signal is replaced
HUNG_S = 6.0  # time without any movement after which a silent role is replaced: a hung disk, a deadlock
HUNG_START_S = 60.0  # the same before its first word: a start reads libraries, perhaps from a slow disk
UNSEEN_S = {"actor": 15.0, "hub": 30.0, "replay": 30.0, "learner": 120.0}  # on another machine; distilling takes long
UNSEEN_WITHOUT_ROOM_S = 60.0  # the same where a successor would find no room: its machine may be cut off for a while
UNSEEN_START_S = 300.0  # the same before its first word, from the first answer of its process on
PAUSE_S = STOPPED_S  # time between two looks after which the watcher itself was stopped, and nobody else is blamed
HUB = "hub-0"  # name of the role through which all others are heard


@dataclass(frozen=True)
class Pulse:
    """Condition of a process at one moment.

    Attributes:
        stopped: whether a signal or a debugger has stopped it.
        movement: number that changes whenever the role's thread computes or is woken.
        wants_processor: whether that thread computes now, or would if others left it a processor.
    """

    stopped: bool
    movement: int
    wants_processor: bool = False


@dataclass
class _Watched:
    """Role that is watched.

    Attributes:
        epoch: epoch of its newest incarnation.
        heard: whether this incarnation has published anything.
        since_s: time from which its silence counts.
        moved_s: time at which its process was last seen to move.
        movement: movement of its process at that time; None: it has not been seen since its last word.
    """

    epoch: int
    heard: bool
    since_s: float
    moved_s: float
    movement: int | None = None

    def calm(self, now: float) -> None:
        """Count its silence from now on."""
        self.since_s, self.moved_s, self.movement = now, now, None


class Heartbeats:
    """Roles by name, with the time of the last word of each.

    Args:
        now: time, seconds, on a clock that never runs backwards.
    """

    def __init__(self, now: float) -> None:
        self._roles: dict[str, _Watched] = {}
        self._looked_s = now

    def expect(self, name: str, epoch: int, now: float) -> None:
        """Watch a new incarnation of a role, which has been started now."""
        self._roles[name] = _Watched(epoch, False, now, now)
        if name == HUB:
            self._calm_others(now)  # nobody can be heard before it listens

    def note_process(self, name: str, now: float) -> None:
        """Note that the process of a role has answered; until then it may have waited for room."""
        if name in self._roles:
            self._roles[name].calm(now)

    def forget(self, name: str) -> None:
        """Watch a role no longer: it has finished."""
        self._roles.pop(name, None)

    def hear(self, name: str, epoch: int, now: float) -> bool:
        """Note a word of a role; return whether it is the first of the newest incarnation.

        A word of an older incarnation is ignored. After a silence of the hub, the others get time to be heard again.
        """
        role = self._roles.get(name)
        if role is None or role.epoch != epoch:
            return False
        if name == HUB and now - role.since_s > SILENT_S:
            self._calm_others(now)
        first, role.heard = not role.heard, True
        role.calm(now)
        return first

    def silent(self, now: float) -> list[str]:
        """Return the roles whose processes should be looked at; the hub alone while it is silent."""
        if now - self._looked_s > PAUSE_S:
            for role in self._roles.values():
                role.calm(now)
        self._looked_s = now
        found = [name for name, role in self._roles.items() if now - role.since_s >= SILENT_S]
        return [HUB] if HUB in found else found

    def verdict(
        self, name: str, pulse: Pulse | None, now: float, has_room: Callable[[], bool] = lambda: True
    ) -> str | None:
        """Return why a silent role has to be replaced, in a few words; None: it has not.

        Args:
            name: name of a role that `silent` returned, whose process has answered.
            pulse: condition of its process; None: it is on another machine.
            now: time, seconds.
            has_room: tells whether a machine has room for a successor; asked only where it matters.
        """
        role = self._roles[name]
        silence_s = now - role.since_s
        if pulse is None:
            patience_s = UNSEEN_S.get(name.partition("-")[0]) if role.heard else UNSEEN_START_S
            lost = patience_s is not None and silence_s >= patience_s
            lost = lost and (silence_s >= UNSEEN_WITHOUT_ROOM_S or has_room())
            return f"nothing was heard of it for {silence_s:.0f} s" if lost else None
        if pulse.stopped:
            return f"its process was stopped for {silence_s:.0f} s" if silence_s >= STOPPED_S else None
        if pulse.wants_processor or pulse.movement != role.movement:
            role.movement, role.moved_s = pulse.movement, now
            return None
        still_s = now - role.moved_s
        hung = still_s >= (HUNG_S if role.heard else HUNG_START_S)
        return f"it hung for {still_s:.0f} s" if hung else None

    def _calm_others(self, now: float) -> None:
        for name, role in self._roles.items():
            if name != HUB:
                role.calm(now)
