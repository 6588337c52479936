"""Result of one check, and the guard that turns an unexpected exception into one."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum


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
    """Return a check's result; where it raises an exception, a failure with the exception's text."""
    try:
        return check()
    except Exception as error:  # a broken part must not end the remaining checks
        found = f"{type(error).__name__}: {' '.join(str(error).split())}"
        return CheckResult(name, CheckStatus.FAIL, found, "Run make install.")
