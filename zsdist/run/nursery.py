"""Nursery: a process that loads what the roles of a run need, once, and forks their processes.

A fork begins with everything loaded, and shares that memory with all others until one of them writes to it. The nursery
also prepares the run, so that the launcher need not load a car. Where it has died, Ray starts each process by itself,
which takes seconds of processor time.
"""

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from zsdist import errors
from zsdist.common import signals
from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.run.nursery_shim import PREPARE, VARIABLE
from zsdist.vision.fingerprint import VisionIdentity

_WAITING = 128  # requests that may wait
_BLOCK = 1 << 16


@contextlib.contextmanager
def employed() -> Iterator[None]:
    """Let a nursery of this process wait for requests meanwhile, unless one does; its end is that of this process too.

    Where the system is not Linux, this does nothing.
    """
    if is_employed() or not sys.platform.startswith("linux"):
        yield
        return
    with contextlib.ExitStack() as held:
        try:
            folder = held.enter_context(tempfile.TemporaryDirectory(prefix="zsdist-"))
            path = str(Path(folder) / "nursery")
            process = held.enter_context(_started(path))
        except OSError:  # no folder for temporary files, or too long a path; Ray, which needs the same, names it
            process = None
        if process is None:
            yield
            return
        held.callback(process.kill)
        before, os.environ[VARIABLE] = os.environ.get(VARIABLE), f"{os.getpid()}:{path}"
        try:
            yield
        finally:
            del os.environ[VARIABLE]
            if before is not None:
                os.environ[VARIABLE] = before


def _started(path: str) -> "subprocess.Popen[bytes]":
    """Start the process, with a socket that listens at a path."""
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen(_WAITING)
        command = [sys.executable, "-m", "zsdist.run.nursery_process", str(listener.fileno())]
        one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # a fork has no others, and may miss them
        with signals.withheld():  # as for Ray's processes, since only the launcher reacts
            return subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                pass_fds=[listener.fileno()],
                env=os.environ | one_thread,
            )


def is_employed() -> bool:
    """Return whether a nursery was started for this process."""
    return os.environ.get(VARIABLE, "").partition(":")[0] == str(os.getpid())


def prepare(config: Config, meanwhile: Callable[[], object]) -> VisionIdentity:
    """Let the nursery check and warm up all that a run needs (`preflight.warm_up`); return the vision model.

    Args:
        config: configuration of the run.
        meanwhile: called here while the nursery works.

    Raises:
        ZsdistError: as `preflight.warm_up` raises it.
        OSError: a file cannot be read or written.
        RunError: the nursery has died.
    """
    with socket.socket(socket.AF_UNIX) as connection:
        try:
            connection.connect(os.environ[VARIABLE].partition(":")[2])
            connection.sendall(PREPARE + config.model_dump_json().encode())
            connection.shutdown(socket.SHUT_WR)
            meanwhile()
            answer = json.loads(b"".join(iter(lambda: connection.recv(_BLOCK), b"")))
        except (OSError, ValueError) as error:
            raise RunError(f"the process that prepares the run has died: {error!r}; start the run again") from error
    if "error" in answer:
        raise _error(answer["error"], answer["message"])
    if "errno" in answer:
        raise OSError(answer["errno"], answer["message"], answer["file"])
    return VisionIdentity.from_json(answer["vision"])


def _error(name: str, message: str) -> Exception:
    """Return an error of `zsdist.errors` by its name."""
    kind: Any = getattr(errors, name)
    error: Exception = kind.__new__(kind, message)
    error.args = (message,)
    return error
