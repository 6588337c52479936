"""Result of one check, and the guard that turns an unexpected exception into one."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from zsdist.errors import ZsdistError


class CheckStatus(StrEnum):
    """Outcome of a check; `WARN`: it works, with a restriction."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True)
class CheckResult:
    """Result of one check.

    Attributes:
        check: name of the check.
        status: outcome of the check.
        found: description of what was found.
        advice: remedy for the user; empty where nothing needs to be done.
    """

    check: str
    status: CheckStatus
    found: str
    advice: str = ""

    def as_json(self) -> dict[str, str]:
        """Return the fields as `zsdist.doctor --json` prints them."""
        return {"check": self.check, "verdict": self.status.value, "found": self.found, "advice": self.advice}


def guarded(name: str, check: Callable[[], CheckResult]) -> CheckResult:
    """Return a check's result; where it raises an exception, a failure with the exception's text and a remedy."""
    try:
        return check()
    except ZsdistError as error:  # its text has the remedy
        return CheckResult(name, CheckStatus.FAIL, " ".join(str(error).split()))
    except Exception as error:  # a broken part must not end the remaining checks
        found = f"{type(error).__name__}: {' '.join(str(error).split())}"
        return CheckResult(name, CheckStatus.FAIL, found, _advice(error))


def _advice(error: Exception) -> str:
    if isinstance(error, ImportError):
        return "Install zsdist again, with pip or with make install: a package is missing or damaged."
    if isinstance(error, MemoryError):
        return "Allow this process more memory (ulimit -v, the batch job, the container)."
    if isinstance(error, OSError):
        return "Check that the file or address can be used by this user, and that the disk is not full."
    return "This is unexpected; please report it with this line and python -m zsdist.doctor --json."
