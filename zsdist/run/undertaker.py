"""Process that ends what a killed launcher has left behind.

A launcher that ends by itself ends Ray's processes too. After SIGKILL they notice its death themselves, but some of
them only a minute later. The undertaker waits for the end of its launcher, however that comes, and kills what is left:
processes that it has seen among the launcher's descendants, and those that carry the launcher's word in their
environment, which Ray overwrites in some. It runs this file alone, without the package.
"""

import contextlib
import os
import secrets
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

WORD = "ZSDIST_LAUNCH"  # variable that every process of a launcher inherits
NOTE_EVERY_S = 2.0
LOOK_EVERY_S = 0.2
LOOKS = 25  # at most; after two without a find it ends
_PROC = Path("/proc")
_PARENT, _STARTED = 1, 19  # fields of `/proc/PID/stat` after the name

Identity = tuple[int, int]  # number of a process, and time of its start


@contextlib.contextmanager
def employed() -> Iterator[None]:
    """Let an undertaker wait meanwhile; processes that are started meanwhile do not outlive this one by long.

    Where the system has no `/proc`, this does nothing.
    """
    if not _PROC.is_dir():
        yield
        return
    before, os.environ[WORD] = os.environ.get(WORD), secrets.token_hex(16)
    command = [sys.executable, "-I", "-S", __file__, str(os.getpid()), os.environ[WORD]]
    try:
        # In a session of its own: a signal to the launcher's process group is not meant for it.
        with subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True):
            yield
    finally:
        del os.environ[WORD]
        if before is not None:
            os.environ[WORD] = before


def bury(word: str, family: set[Identity]) -> None:
    """Kill the processes of a family and all that carry a word, until there are none."""
    alone = 0
    for _ in range(LOOKS):
        found = [identity for identity in _processes() if identity in family or _carries(identity[0], word)]
        for pid, _ in found:
            with contextlib.suppress(OSError):  # it has ended meanwhile
                os.kill(pid, signal.SIGKILL)
        alone = 0 if found else alone + 1
        if alone == 2:
            return
        time.sleep(LOOK_EVERY_S)


def descendants(pid: int) -> set[Identity]:
    """Return the present descendants of a process, except this one."""
    children: dict[int, list[Identity]] = {}
    for identity, parent in _processes().items():
        children.setdefault(parent, []).append(identity)
    found, waiting = set[Identity](), [pid]
    while waiting:
        for identity in children.get(waiting.pop(), ()):
            found.add(identity)
            waiting.append(identity[0])
    return found


def _processes() -> dict[Identity, int]:
    """Return all processes except this one and zombies, each with its parent."""
    found = {}
    for folder in _PROC.iterdir():
        if folder.name.isdigit() and int(folder.name) != os.getpid():
            with contextlib.suppress(OSError):
                fields = (folder / "stat").read_bytes().rpartition(b")")[2].split()
                if fields[0] != b"Z":
                    found[int(folder.name), int(fields[_STARTED])] = int(fields[_PARENT])
    return found


def _carries(pid: int, word: str) -> bool:
    with contextlib.suppress(OSError):  # it has ended meanwhile, or is another user's
        return f"{WORD}={word}".encode() in (_PROC / str(pid) / "environ").read_bytes().split(b"\0")
    return False


def _wait(launcher: int) -> set[Identity]:
    """Wait for the end of the launcher; return all its descendants that were seen until then and may live."""
    family: set[Identity] = set()
    while not select.select([sys.stdin], [], [], NOTE_EVERY_S)[0]:
        family = (family & _processes().keys()) | descendants(launcher)
    return family


if __name__ == "__main__":
    bury(sys.argv[2], _wait(int(sys.argv[1])))
