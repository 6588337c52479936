"""Process of the nursery, whose argument is the number of a listening socket: it loads modules and forks on request.

A request begins with a byte: `FORK`, with the streams of the new process and a JSON object
(`nursery_shim.ask`), or `PREPARE`, with the configuration of a run. Between requests it loads one part after the other.
It has one thread, since a fork would wait for ever for what another thread holds. When its standard input ends, its
launcher is gone, and it kills its forks.
"""

import contextlib
import gc
import importlib
import json
import os
import resource
import runpy
import select
import signal
import socket
import sys
from pathlib import Path
from typing import Any, cast

from zsdist.common import folders
from zsdist.run import allocator
from zsdist.run.nursery_shim import FORK, PREPARE, TAKEN

PARTS = (  # loaded one by one, in the order in which a run needs them
    ("zsdist.run.role_host",),
    ("zsdist.roles.replay.role", "zsdist.roles.scheduler.role", "zsdist.roles.actor"),
    ("zsdist.run.learners", "zsdist.dqn.fused"),
)
WORKER = "ray._private.workers.default_worker"
_THREADS, _LIKELIHOOD_OF_DEATH = Path("/proc/self/task"), Path("/proc/self/oom_score_adj")
_FIRST = "1000"  # where memory runs out, a role dies before the launcher, as a worker of Ray does
_BLOCK = 1 << 16

Request = dict[str, Any]


class Nursery:
    """Server of one launcher.

    Args:
        listener: socket at which requests arrive.
        lifeline: descriptor that ends with the launcher.
    """

    def __init__(self, listener: socket.socket, lifeline: int) -> None:
        self._listener = listener
        self._lifeline = lifeline
        self._waiting = list(PARTS)
        self._forks: set[int] = set()
        self._ended, self._wakes = os.pipe()  # readable where a fork has ended
        os.set_blocking(self._ended, False)
        os.set_blocking(self._wakes, False)
        signal.signal(signal.SIGCHLD, lambda number, frame: None)
        signal.set_wakeup_fd(self._wakes, warn_on_full_buffer=False)

    def serve(self) -> Request | None:
        """Load all parts and answer requests until the launcher is gone; in a fork, return its request."""
        while True:
            sources: list[Any] = [self._listener, self._lifeline, self._ended]
            readable, _, _ = select.select(sources, [], [], 0.0 if self._waiting else None)
            if self._ended in readable:
                self._bury()
            elif self._lifeline in readable:
                self._bury()
                for pid in self._forks:
                    os.kill(pid, signal.SIGKILL)
                return None
            elif self._listener in readable:
                connection, _ = self._listener.accept()
                with connection:
                    if (request := self._answer(connection)) is not None:
                        return request
            elif self._waiting:
                for name in self._waiting.pop(0):
                    importlib.import_module(name)

    def _bury(self) -> None:
        """Note the forks that have ended, so that their numbers can be used again."""
        with contextlib.suppress(BlockingIOError):
            os.read(self._ended, _BLOCK)
        with contextlib.suppress(ChildProcessError):
            while (pid := os.waitpid(-1, os.WNOHANG)[0]) != 0:
                self._forks.discard(pid)

    def _answer(self, connection: socket.socket) -> Request | None:
        """Answer a request; return it where this is the new process that it asks for."""
        kind, streams, _, _ = socket.recv_fds(connection, 1, 3)
        content = b"".join(iter(lambda: connection.recv(_BLOCK), b""))
        answer = TAKEN
        if kind == PREPARE:
            answer = json.dumps(prepared(content.decode())).encode()
        elif kind != FORK or len(streams) != 3:
            answer = b""  # the one who asked is gone
        elif not self._fork(request := json.loads(content)):
            become(request, streams)
            return cast(Request, request)
        with contextlib.suppress(BrokenPipeError):
            connection.sendall(answer)
        for stream in streams:
            os.close(stream)
        return None

    def _fork(self, request: Request) -> bool:
        """Fork; return whether this is the old process."""
        if (
            "ray" not in sys.modules
        ):  # it reads its environment when it is imported; that of all its workers is the same
            os.environ.update(request["environment"])
            importlib.import_module(WORKER)
        if (threads := len(folders.visible(_THREADS))) > 1:
            raise SystemExit(f"the nursery cannot be forked, since a library has started {threads - 1} threads in it")
        gc.collect()
        allocator.return_freed_memory()
        gc.freeze()  # else the collector would write to all shared pages
        pid = os.fork()
        if pid:
            self._forks.add(pid)
            return True
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        self._listener.close()
        os.close(self._ended)
        os.close(self._wakes)
        return False


def become(request: Request, streams: list[int]) -> None:
    """Take the streams, the environment, the folder and the limits of the process that asked for this fork."""
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["folder"])
    resource.setrlimit(resource.RLIMIT_NOFILE, tuple(request["open_files"]))
    with contextlib.suppress(OSError):  # not all containers allow it
        _LIKELIHOOD_OF_DEATH.write_text(_FIRST, encoding="utf-8")


def prepared(settings: str) -> Request:
    """Check and warm up all that a run needs; return its vision model, or the error, as a JSON object."""
    from zsdist.config import Config
    from zsdist.errors import ZsdistError
    from zsdist.run import preflight

    try:
        return {"vision": preflight.warm_up(Config.model_validate_json(settings)).to_json()}
    except ZsdistError as error:
        return {"error": type(error).__name__, "message": str(error)}
    except OSError as error:  # of the system, such as a full disk
        return {"errno": error.errno, "message": error.strerror, "file": error.filename}


def main() -> None:
    """Serve; a fork goes on as the worker that it was asked to be."""
    with socket.socket(fileno=int(sys.argv[1])) as listener:
        request = Nursery(listener, sys.stdin.fileno()).serve()
    if request is not None:
        sys.argv = request["arguments"]
        runpy.run_path(sys.argv[0], run_name="__main__")


if __name__ == "__main__":
    main()
