"""Profile of a run: where the threads of its roles spend their time, sampled a hundred times a second.

A profile is a folder with a text file for each role, in the form that flame graph tools read (speedscope, FlameGraph):
a line is a stack from the role's step to the innermost function, separated by `;`, then a space and its microseconds.
The stack `waiting` stands for the time in which a role has nothing to do.
"""

import sys
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, FrameType

from zsdist.common import atomic_files, folders
from zsdist.roles.base import Role
from zsdist.run.program import RoleSpec

FOLDER, SUFFIX = "profile", ".folded"
WAITING = "waiting"
SAMPLE_EVERY_S = 0.01
WRITE_EVERY_S = 5.0

Stack = tuple[CodeType, ...]


@contextmanager
def sampled(run_folder: Path, role_spec: RoleSpec) -> Iterator[None]:
    """Sample this thread meanwhile, and write a profile into the run directory every few seconds and at the end.

    Args:
        run_folder: run directory; where it does not exist, on another machine, nothing is done.
        role_spec: role that gets the time in which no role is stepped, and the epoch by which incarnations differ.
    """
    if not run_folder.is_dir():
        yield
        return
    sampler = Sampler(run_folder / FOLDER, role_spec)
    sampler.start()
    try:
        yield
    finally:
        sampler.end()


class Sampler(threading.Thread):
    """Thread that samples the one which has made it.

    Args:
        folder: folder of the profile.
        role_spec: role that gets the time in which no role is stepped, and the epoch by which incarnations differ.
    """

    def __init__(self, folder: Path, role_spec: RoleSpec) -> None:
        super().__init__(name="zsdist-profile", daemon=True)
        self._folder = folder
        self._role_spec = role_spec
        self._sampled = threading.get_ident()
        self._time_us: defaultdict[str, Counter[Stack]] = defaultdict(Counter)
        self._end = threading.Event()

    def run(self) -> None:
        """Sample until the end."""
        seen_s = written_s = time.monotonic()
        while not self._end.wait(SAMPLE_EVERY_S):
            now = time.monotonic()
            frame = sys._current_frames().get(self._sampled)
            if frame is not None:
                role, stack = _stack(frame)
                self._time_us[role or self._role_spec.name][stack] += round(1e6 * (now - seen_s))
            seen_s = now
            if now - written_s >= WRITE_EVERY_S:
                written_s = now
                self._write()

    def end(self) -> None:
        """End the thread and write what it has sampled."""
        self._end.set()
        self.join()
        self._write()

    def _write(self) -> None:
        self._folder.mkdir(exist_ok=True)
        for role, stacks in self._time_us.items():
            lines = [f"{';'.join(map(_name, stack)) or WAITING} {time_us}\n" for stack, time_us in stacks.items()]
            path = self._folder / f"{role}.{self._role_spec.epoch}{SUFFIX}"
            atomic_files.write(path, "".join(sorted(lines)).encode())


def _stack(frame: FrameType) -> tuple[str | None, Stack]:
    """Return the role that is stepped in a thread and its stack from there on; None and an empty one without a role."""
    stack: list[CodeType] = []
    inner: FrameType | None = frame
    while inner is not None:
        if inner.f_code is Role.step.__code__:
            role: Role = inner.f_locals["self"]
            return role.context.name, tuple(reversed(stack))
        stack.append(inner.f_code)
        inner = inner.f_back
    return None, ()


def _name(code: CodeType) -> str:
    """Return module and function of code, without the signs that separate stacks."""
    parts = Path(code.co_filename).with_suffix("").parts
    roots = [index for index, part in enumerate(parts) if part in ("zsdist", "site-packages")]
    module = ".".join(parts[roots[-1] + (parts[roots[-1]] != "zsdist") :] if roots else parts[-1:])
    return f"{module}:{code.co_qualname}".replace(";", ",").replace(" ", "_")


def read(run_folder: Path) -> dict[str, Counter[tuple[str, ...]]]:
    """Return the microseconds of each stack, by role, over all incarnations; empty where there is no profile.

    Raises:
        ValueError: a file is damaged.
    """
    found: defaultdict[str, Counter[tuple[str, ...]]] = defaultdict(Counter)
    for path in folders.visible(run_folder / FOLDER, f"*{SUFFIX}"):
        role = path.name.removesuffix(SUFFIX).rpartition(".")[0]
        for line in path.read_text(encoding="utf-8").splitlines():
            stack, _, time_us = line.rpartition(" ")
            found[role][tuple(stack.split(";"))] += int(time_us)
    return dict(found)


def part(stack: tuple[str, ...]) -> str:
    """Return the part of zsdist that the time of a stack belongs to: the innermost one, such as `vision`."""
    for name in reversed(stack):
        package, *parts = name.partition(":")[0].split(".")
        if package == "zsdist" and parts:
            return ".".join(parts[:2]) if parts[0] in ("sim", "planning") else parts[0]
    return stack[-1] if stack == (WAITING,) else "roles"
