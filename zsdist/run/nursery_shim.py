"""Process that Ray's raylet starts as a worker: it asks the nursery for a fork, and becomes a worker itself otherwise.

It runs alone, by its path, and imports only the standard library. Its arguments are those of Ray's `setup_worker.py`:
the file of a worker, then options.
"""

import json
import os
import resource
import socket
import sys
from pathlib import Path

VARIABLE = "ZSDIST_NURSERY"  # number of the launcher's process, a colon, and the path of its nursery's socket
FORK, PREPARE = b"f", b"p"  # first bytes of requests
TAKEN = b"1"  # answer of a nursery that has forked
ANSWER_WITHIN_S = 60.0  # longest time for which a nursery loads modules
SETUP = "setup_worker.py"  # beside the file of a worker
_LANGUAGE, _ENVIRONMENT = "--language=", "--serialized-runtime-env-context="  # options that a worker does not know


def ask(path: str, arguments: list[str]) -> bool:
    """Ask the nursery at a socket for a fork with this process's environment, streams and limits.

    Returns:
        Whether it has forked.
    """
    request = {
        "arguments": [argument for argument in arguments if not argument.startswith((_LANGUAGE, _ENVIRONMENT))],
        "environment": dict(os.environ),
        "folder": os.getcwd(),
        "open_files": resource.getrlimit(resource.RLIMIT_NOFILE),
    }
    try:
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(ANSWER_WITHIN_S)
            connection.connect(path)
            socket.send_fds(connection, [FORK], [0, 1, 2])
            connection.sendall(json.dumps(request).encode())
            connection.shutdown(socket.SHUT_WR)
            return connection.recv(1) == TAKEN
    except OSError:  # it is gone
        return False


def is_plain(arguments: list[str]) -> bool:
    """Return whether a worker runs Python in no environment of its own, which only Ray can set up."""
    allowed = (_LANGUAGE + "PYTHON", _ENVIRONMENT, _ENVIRONMENT + "{}")
    return all(argument in allowed for argument in arguments if argument.startswith((_LANGUAGE, _ENVIRONMENT)))


def main(arguments: list[str]) -> None:
    """Hand the worker over to the nursery; where that is gone, become the process that Ray starts by itself."""
    path = os.environ[VARIABLE].partition(":")[2]
    if is_plain(arguments) and ask(path, arguments):
        return
    worker = next(argument for argument in arguments if argument.endswith(".py"))
    os.execv(sys.executable, [sys.executable, str(Path(worker).with_name(SETUP)), *arguments])


if __name__ == "__main__":
    main(sys.argv[1:])
