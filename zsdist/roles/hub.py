"""The hub role: the process in which the transport's router lives; it says that it is there and how loaded it is."""

import resource

from zsdist.roles.base import STATISTICS_EVERY_S, Context, Role
from zsdist.telemetry.snapshot import Fields


class Hub(Role):
    """Holds no state; its runner ends it after all the others."""

    def __init__(self, context: Context, endpoint: str) -> None:
        super().__init__(context)
        self.endpoint = endpoint

    def work(self, now: float) -> float:
        """Nothing to do but to be there."""
        return now + STATISTICS_EVERY_S

    def statistics(self) -> Fields:
        """Where it listens, and what it costs."""
        usage = resource.getrusage(resource.RUSAGE_SELF)
        return {
            "endpoint": self.endpoint,
            "cpu_s": round(usage.ru_utime + usage.ru_stime, 2),
            "peak_kib": usage.ru_maxrss,
        }
