"""Ray on this machine alone: its address, its size and the files that it holds open, decided before it is imported."""

import os
import resource

from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.run import program

FILES_OF_RAY = 128  # open files of Ray's largest process without any role: connections, logs, libraries
FILES_OF_A_PROCESS = 4  # open files that it needs for each process: its logs, its connections


def is_used(config: Config) -> bool:
    """Return whether a run starts Ray on this machine."""
    return config.placement == "ray" and config.run.address is None


def stay_on_loopback() -> None:
    """Make Ray listen at 127.0.0.1 only; call it before anything imports Ray.

    Ray takes the address of the network in place of any loopback address that it is given, and listens at all of them.
    """
    os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"  # read at the import, on Linux too


def process_count(config: Config) -> int:
    """Return the number of processes that a run asks of Ray: the roles, the hub and the spare."""
    return program.role_count(config) + 1 + config.run.standby


def logical_cores(config: Config, cores: int) -> int:
    """Return the number of cores that Ray is told of; no role then ever waits to be placed.

    Ray starts a process for each of them before it is asked to, so a machine with many cores needs no more than a run
    has processes.

    Args:
        config: configuration of the run.
        cores: number of cores of this machine.
    """
    processes = process_count(config)
    return max(min(cores, processes), int(config.run.cpus_per_role * processes) + 1)


def check_open_files(config: Config) -> None:
    """Check that Ray may hold as many files open as a run on this machine needs.

    Ray raises the limit of its processes to the hard one. Where that is too low, its own process dies while the roles
    are started.

    Raises:
        RunError: it may not.
    """
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    processes = process_count(config)
    needed = FILES_OF_RAY + FILES_OF_A_PROCESS * processes
    if hard != resource.RLIM_INFINITY and hard < needed:
        raise RunError(
            f"the limit of open files is {hard}: Ray needs {needed} for {processes} processes; raise it (ulimit -n, as "
            "an administrator, or the limit of the container), lower run.actors, or use --single-process"
        )
