"""Search path of imports in the package's own processes, without the working folder.

Python and Ray put the working folder first on the path. A user's `random.py`, `ray.py` or `zenoh.py` in it would then
stand in for the module of that name in every import of every library. Importing this module takes the folder out,
in the package's commands and in the workers that Ray starts; a program that imports the package keeps its path.
"""

import os
import sys
from collections.abc import Sequence
from itertools import pairwise

_PACKAGE = "zsdist"
_RAY_WORKER = "default_worker.py"  # name of the script that Ray's workers run


def is_command(arguments: Sequence[str]) -> bool:
    """Return whether a command line is that of a command of the package: `python -m zsdist...`, or `zsdist ...`.

    Args:
        arguments: command line of the process, the interpreter included.
    """
    if any(one == "-m" and other.partition(".")[0] == _PACKAGE for one, other in pairwise(arguments)):
        return True
    return len(arguments) > 1 and os.path.basename(arguments[1]) == _PACKAGE  # the script that pip installs


def leave_out_working_folder(path: list[str], arguments: list[str], working_folder: str, home: str) -> None:
    """Take the working folder out of a search path, in place, in the package's own processes.

    Args:
        path: folders in which modules are searched, in order.
        arguments: command line of the process, the interpreter included.
        working_folder: folder in which the process was started.
        home: folder that holds the package, which stays.
    """
    is_worker = any(os.path.basename(argument) == _RAY_WORKER for argument in arguments)
    if not (is_command(arguments) or is_worker) or os.path.realpath(working_folder) == os.path.realpath(home):
        return
    if path and path[0] in ("", working_folder):
        del path[0]


def _working_folder() -> str:
    try:
        return os.getcwd()
    except FileNotFoundError:  # it was removed
        return ""


def apply() -> None:
    """Take the working folder out of this process's path; a worker that was forked calls it after Ray has put it in."""
    home = os.path.dirname(os.path.dirname(os.path.dirname(__file__)))
    leave_out_working_folder(sys.path, sys.orig_argv, _working_folder(), home)


apply()
