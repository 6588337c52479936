"""Process that ends what a killed launcher has left behind.

A launcher that ends by itself ends Ray's processes too. After SIGKILL they notice its death themselves, but some of
them only a minute later. The undertaker waits for the end of its launcher, however that comes, and kills each process
that still carries the launcher's word in its environment. It runs this file alone, without the package.
"""

import contextlib
import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

WORD = "ZSDIST_LAUNCH"  # variable that every process of a launcher inherits
LOOK_EVERY_S = 0.2
LOOKS = 25  # at most; after two without a find it ends
_PROC = Path("/proc")


@contextlib.contextmanager
def employed() -> Iterator[None]:
    """Let an undertaker wait meanwhile; processes that are started meanwhile do not outlive this one by long.

    Where the system has no `/proc`, this does nothing.
    """
    if not _PROC.is_dir():
        yield
        return
    before, os.environ[WORD] = os.environ.get(WORD), secrets.token_hex(16)
    command = [sys.executable, "-I", "-S", __file__, os.environ[WORD]]
    try:
        # In a session of its own: a signal to the launcher's process group is not meant for it.
        with subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True):
            yield
    finally:
        del os.environ[WORD]
        if before is not None:
            os.environ[WORD] = before


def bury(word: str) -> None:
    """Kill all processes that carry a word, until there are none."""
    alone = 0
    for _ in range(LOOKS):
        alone = 0 if _kill(word) else alone + 1
        if alone == 2:
            return
        time.sleep(LOOK_EVERY_S)


def _kill(word: str) -> bool:
    """Kill the processes of this user that carry a word; return whether there were any."""
    mark, found = f"{WORD}={word}".encode(), False
    for folder in _PROC.iterdir():
        if not folder.name.isdigit() or int(folder.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):  # it has ended meanwhile, or is another user's
            if mark in (folder / "environ").read_bytes().split(b"\0"):
                os.kill(int(folder.name), signal.SIGKILL)
                found = True
    return found


if __name__ == "__main__":
    sys.stdin.read()  # ends with the launcher
    bury(sys.argv[1])
