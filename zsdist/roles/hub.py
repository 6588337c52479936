"""The hub role: the process in which the transport's router lives; it says that it is there and how loaded it is."""

import resource

from zsdist.roles.base import STATISTICS_EVERY_S, Context, Role
from zsdist.roles.snapshot import Fields
from zsdist.wire import keys
from zsdist.wire.messages import Orders


class Hub(Role):
    """Holds no state; ends when the scheduler says that the run is over."""

    def __init__(self, context: Context, endpoint: str) -> None:
        super().__init__(context)
        self.endpoint = endpoint
        self._orders = self.mailbox("orders")
        self.transport.subscribe(keys.control(context.run, "hub"), self._orders, retained=True)

    def work(self, now: float) -> float:
        for _, orders in self.messages(self._orders):
            if isinstance(orders, Orders):
                self.finished = orders.content["stop"]
        return now + STATISTICS_EVERY_S

    def statistics(self) -> Fields:
        usage = resource.getrusage(resource.RUSAGE_SELF)
        return {"endpoint": self.endpoint, "cpu_s": round(usage.ru_utime + usage.ru_stime, 2), "peak_kib": usage.ru_maxrss}
