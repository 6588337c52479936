"""Hub role: the process that holds the transport's router. It publishes its presence and its load."""

import resource

from zsdist.roles.base import STATISTICS_EVERY_S, Context, Role
from zsdist.telemetry.snapshot import Fields


class Hub(Role):
    """Role without state, which its runner ends after all others."""

    def __init__(self, context: Context, endpoint: str) -> None:
        super().__init__(context)
        self.endpoint = endpoint

    def work(self, now: float) -> float:
        """Return the time of the next statistics; the router does all the work."""
        return now + STATISTICS_EVERY_S

    def statistics(self) -> Fields:
        """Return the endpoint, and the load of the process."""
        usage = resource.getrusage(resource.RUSAGE_SELF)
        return {
            "endpoint": self.endpoint,
            "cpu_s": round(usage.ru_utime + usage.ru_stime, 2),
            "peak_kib": usage.ru_maxrss,
        }
