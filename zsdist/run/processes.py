"""Processes of this machine as the system describes them (`/proc`): their condition, and their certain end."""

import contextlib
import os
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from zsdist.common import folders
from zsdist.run.heartbeats import Pulse

ROLE_THREAD = "zsdist-role"  # name of the thread of a role, at most 15 characters
GONE_WITHIN_S = 5.0  # longest wait for the end of a killed process
_PROC = Path("/proc")
_STATE, _USER_TICKS, _SYSTEM_TICKS, _STARTED = 0, 11, 12, 19  # fields of `/proc/PID/stat` after the name
_STOPPED, _DEAD, _RUNNABLE = b"Tt", b"ZX", b"R"


@dataclass(frozen=True)
class ProcessIdentity:
    """Identity of a process, which no later process with its number shares.

    Attributes:
        pid: number of the process.
        started: time of its start, in ticks since the machine's.
    """

    pid: int
    started: int

    @classmethod
    def here(cls) -> "ProcessIdentity":
        """Return the identity of this process; `started` is 0 where the system does not tell."""
        fields = _stat(_PROC / "self" / "stat")
        return cls(os.getpid(), int(fields[_STARTED]) if fields else 0)

    def lives(self) -> bool:
        """Return whether it is there and not a zombie."""
        fields = self._fields()
        return fields is not None and fields[_STATE] not in _DEAD

    def pulse(self) -> Pulse | None:
        """Return its condition; None where it is gone."""
        fields = self._fields()
        if fields is None or fields[_STATE] in _DEAD:
            return None
        thread, switches = self._role_thread(fields)
        return Pulse(fields[_STATE] in _STOPPED, switches + _ticks(thread), thread[_STATE] == _RUNNABLE)

    def kill(self) -> bool:
        """Kill it, also where it is stopped; return whether it is gone."""
        if not self.lives():
            return True
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)
        give_up_s = time.monotonic() + GONE_WITHIN_S
        while self.lives() and time.monotonic() < give_up_s:
            time.sleep(0.005)
        return not self.lives()

    def _fields(self) -> list[bytes] | None:
        fields = _stat(_PROC / str(self.pid) / "stat") if self.started else None
        return fields if fields and int(fields[_STARTED]) == self.started else None

    def _role_thread(self, fields: list[bytes]) -> tuple[list[bytes], int]:
        """Return fields and context switches of the role's thread; without one, the fields of the process and 0."""
        for task in _tasks(self.pid):
            with contextlib.suppress(OSError):
                if (task / "comm").read_text(encoding="utf-8").strip() == ROLE_THREAD:
                    status = (task / "status").read_text(encoding="utf-8").splitlines()
                    switches = sum(int(line.split()[1]) for line in status if "_ctxt_switches" in line)
                    return _stat(task / "stat") or fields, switches
        return fields, 0


def name_role_thread() -> None:
    """Give this thread the name by which `ProcessIdentity.pulse` finds it, where the system has such names."""
    with contextlib.suppress(OSError):
        (_PROC / "self" / "task" / str(threading.get_native_id()) / "comm").write_bytes(ROLE_THREAD.encode())


def _tasks(pid: int) -> list[Path]:
    return folders.visible(_PROC / str(pid) / "task")


def _stat(path: Path) -> list[bytes] | None:
    """Return the fields of a `stat` file after the name, which may contain anything; None where there is none."""
    try:
        return path.read_bytes().rpartition(b")")[2].split()
    except OSError:
        return None


def _ticks(fields: list[bytes]) -> int:
    return int(fields[_USER_TICKS]) + int(fields[_SYSTEM_TICKS])
