"""Checks of the interpreter, the installed packages, and the machine's cores, memory and disk."""

import importlib.metadata
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from zsdist.common.allowed_resources import allowed_cores, allowed_memory_bytes
from zsdist.common.cache_folder import (
    NUMBA_VARIABLE,
    VARIABLE,
    cache_folder,
    compiled_code_folder,
    is_temporary,
    is_writable,
)
from zsdist.diagnostics.result import CheckResult, CheckStatus

INSTALL = "Run make install, or install zsdist again with pip."
CORES, MEMORY_GIB, DISK_GIB = 2, 4.0, 2.0  # with less, the default run is slow or fails
TEMPORARY_GIB, TEMPORARY_SHARE = 1.0, 0.95  # Ray spills no objects into a disk that is fuller


def check_python(version: tuple[int, ...] = sys.version_info[:3]) -> CheckResult:
    """Compare the interpreter's version with the one that the package requires."""
    text = ".".join(str(part) for part in version)
    try:
        required = importlib.metadata.metadata("zsdist")["Requires-Python"]
    except importlib.metadata.PackageNotFoundError:
        return CheckResult("python", CheckStatus.FAIL, f"{text}; zsdist itself is not installed", INSTALL)
    if not SpecifierSet(required).contains(text):
        return CheckResult("python", CheckStatus.FAIL, f"{text}; allowed is {required}", "Install with Python 3.11.")
    return CheckResult("python", CheckStatus.OK, f"{text} at {sys.executable}")


def check_packages(requirements: list[str] | None = None) -> Iterator[CheckResult]:
    """Compare every required package with its allowed range; one result for all where none is wrong.

    Args:
        requirements: requirements such as `numpy>=2`; None: the requirements of the installed zsdist.
    """
    if requirements is None:
        try:
            requirements = importlib.metadata.requires("zsdist") or []
        except importlib.metadata.PackageNotFoundError:
            return  # `check_python` reports it
    needed = [requirement for text in requirements if (requirement := Requirement(text)).marker is None]
    all_in_range = True
    for requirement in needed:
        try:
            version = importlib.metadata.version(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            version = "missing"
        if version == "missing" or not requirement.specifier.contains(version):
            all_in_range = False
            found = f"{version}; allowed is {requirement.specifier}"
            yield CheckResult(f"package {requirement.name}", CheckStatus.FAIL, found, INSTALL)
    if all_in_range:
        yield CheckResult("packages", CheckStatus.OK, f"{len(needed)} packages within their ranges")


def check_resources() -> Iterator[CheckResult]:
    """Compare allowed cores, allowed memory and free disk space with what the default run needs."""
    yield compare_amount("cores", allowed_cores(), CORES, "", "Expect the default run to take longer.")
    yield compare_amount("memory", allowed_memory_bytes() / 2**30, MEMORY_GIB, " GiB", "Use fewer actors: --actors 1.")
    free_gib = shutil.disk_usage(Path.cwd()).free / 2**30
    yield compare_amount("disk", free_gib, DISK_GIB, " GiB free here", "Make room, or set --run-dir to another disk.")


def check_temporary() -> CheckResult:
    """Compare the room in the folder for temporary files, which Ray and the reading cache use, with what they need."""
    folder = Path(tempfile.gettempdir())
    usage = shutil.disk_usage(folder)
    free_gib, used = usage.free / 2**30, 1 - usage.free / usage.total
    found = f"{folder}: {free_gib:.3g} GiB free, {100 * used:.0f}% full"
    if free_gib >= TEMPORARY_GIB and used <= TEMPORARY_SHARE:
        return CheckResult("temporary folder", CheckStatus.OK, found)
    wanted = f"{TEMPORARY_GIB:g} GiB free and at most {100 * TEMPORARY_SHARE:.0f}% full are recommended"
    advice = "Make room there, or set the environment variable TMPDIR to a folder on another disk."
    return CheckResult("temporary folder", CheckStatus.WARN, f"{found}; {wanted}", advice)


def check_cache() -> CheckResult:
    """Check that exported networks and compiled code can be kept, and outlive the next cleaning."""
    folder = cache_folder()
    states = f"Set the environment variable {VARIABLE} to a folder that you can write"
    if not is_writable(folder):
        found = f"{folder} cannot be written; compiled code is not kept, so every process takes minutes to start"
        return CheckResult("cache", CheckStatus.WARN, found, f"{states}.")
    if compiled_code_folder() is None:
        found = f"{folder}; compiled code is not kept, since {NUMBA_VARIABLE} cannot be written"
        return CheckResult("cache", CheckStatus.WARN, found, f"Remove the environment variable {NUMBA_VARIABLE}.")
    if is_temporary(folder):
        found = f"{folder}, since the home folder cannot be written"
        return CheckResult("cache", CheckStatus.WARN, found, f"{states} and that is kept.")
    return CheckResult("cache", CheckStatus.OK, str(folder))


def compare_amount(check: str, found: float, recommended: float, unit: str, advice: str) -> CheckResult:
    """Return a warning with `advice` if less was found than is recommended, else a success."""
    if found >= recommended:
        return CheckResult(check, CheckStatus.OK, f"{found:.3g}{unit}")
    return CheckResult(check, CheckStatus.WARN, f"{found:.3g}{unit}; {recommended:g} are recommended", advice)
