"""Cores and memory that this process may use, which are fewer than the machine's in a batch job or a container.

No other file asks the system for the number of cores or the size of the memory.
"""

import math
import os
from collections.abc import Iterator
from pathlib import Path

PROC, CGROUPS = Path("/proc"), Path("/sys/fs/cgroup")
BATCH_VARIABLES = ("SLURM_CPUS_ON_NODE", "SLURM_CPUS_PER_TASK")
"""Cores of a batch job, which some batch systems state without enforcing them."""


def allowed_cores(proc: Path = PROC, cgroups: Path = CGROUPS) -> int:
    """Return the number of cores that this process may use: 1 or more.

    It is the least of the process's affinity (`taskset`, a batch system), the quota of its cgroup and of all cgroups
    around it (a container), rounded up to whole cores, and what Slurm states.

    Args:
        proc: where the file system of processes is mounted.
        cgroups: where the file system of cgroups is mounted.
    """
    limits = [float(len(os.sched_getaffinity(0)))]
    for folder in _folders(proc, cgroups, "cpu"):
        limits += _quota((_text(folder / "cpu.max") or "").split())
        limits += _quota([_text(folder / f"cpu.cfs_{name}_us") or "" for name in ("quota", "period")])
    limits += [float(value) for name in BATCH_VARIABLES if (value := os.environ.get(name, "")).isdecimal()]
    return max(1, math.ceil(min(limits)))


def allowed_memory_bytes(proc: Path = PROC, cgroups: Path = CGROUPS) -> int:
    """Return the bytes of memory that this process may use: the machine's, or the least limit of a cgroup around it.

    Args:
        proc: where the file system of processes is mounted.
        cgroups: where the file system of cgroups is mounted.
    """
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    for folder in _folders(proc, cgroups, "memory"):
        for name in ("memory.max", "memory.high", "memory.limit_in_bytes"):
            text = _text(folder / name) or ""
            limits += [int(text)] if text.isdecimal() else []  # else "max", or no file
    return min(limits)


def _folders(proc: Path, cgroups: Path, controller: str) -> Iterator[Path]:
    """Yield the folders of the cgroups that this process is in, from the innermost to the root, in both versions.

    A container may see the path of its cgroup on the host and have only its own cgroup mounted, as the root. So folders
    that do not exist are among the result.
    """
    for line in (_text(proc / "self" / "cgroup") or "").splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers and controller not in controllers.split(","):
            continue
        for mounted in {controllers, controller} if controllers else {"", "unified"}:
            inner = cgroups / mounted / path.lstrip("/")
            yield inner
            while inner != cgroups / mounted:
                inner = inner.parent
                yield inner


def _quota(values: list[str]) -> list[float]:
    """Return the cores that a quota and its period in microseconds allow; nothing where the quota is no number."""
    if len(values) != 2 or not all(value.isdecimal() for value in values):
        return []  # "max" or -1: no limit
    quota, period = map(int, values)
    return [quota / period] if quota and period else []


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:  # not there, or not readable in this container
        return None
