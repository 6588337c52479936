"""Memory of the replay while its learner is stalled and 16 actors push, compared with its budget.

`python benchmarks/stalled.py [--quick] [--minutes M]` prints a table, then one JSON line. Hub and replay are processes
of their own, as in a run. Another process asks for batches of both levels, as two learners would, until the first
batches of the low level have been served. Then it is stopped (SIGSTOP): it stays connected and does not read, with
requests of both levels pending. From then on 16 actors push at both levels for `M` minutes: at the low level within
their credit, which the replay of a stalled learner soon withholds; at the high level, whose `min_size` is out of reach,
without any limit, so that its ring and its journal are overwritten all the time.

The budget is the memory of the idle replay (measured) plus the memory that its configuration allows: both rings full,
the bytes of its five mailboxes, and one more copy of the rings, for the part of one that its journal writes when it
starts a new file. Memory is resident memory, read 20 times a second.
"""

import argparse
import json
import multiprocessing
import os
import signal
import statistics
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

from _common import report
from _replay import RUN, Actors, ReplayService, Sampler

from zsdist.config import Config, parse
from zsdist.transport.base import Mailbox
from zsdist.transport.zenoh import ZenohTransport
from zsdist.types import Level
from zsdist.wire import keys

STATE_SIZE = 256  # a transition of 2 KB, as in `replay`
ACTORS = 16
AHEAD = 64  # transitions that each actor has waiting
MAILBOXES = 5  # mailboxes of a replay
MIB = 2**20


def main() -> None:
    """Stall the learner, push, and print the memory of the replay's process."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="20 s of pushing; ends within 50 s on two cores")
    parser.add_argument("--minutes", type=float, default=10.0, metavar="M", help="duration of pushing; 10 by default")
    options = parser.parse_args()
    seconds = 20.0 if options.quick else 60 * options.minutes
    config = parse({"run": {"actors": ACTORS}, "high": {"min_size": 10**9}})
    with ReplayService(config, STATE_SIZE) as service:
        idle = service.resident_bytes()
        transport = ZenohTransport(service.endpoint)
        statistics_box = Mailbox(16 * MIB)
        transport.subscribe(keys.stats(RUN, "replay", "0"), statistics_box)
        epochs = {f"actor-{index}": index + 1 for index in range(ACTORS)}
        crews = [Actors(transport, config, level, epochs, STATE_SIZE) for level in Level]
        service.admit(epochs)
        learner = multiprocessing.get_context("spawn").Process(target=_learn, args=(service.endpoint, config))
        learner.start()
        try:
            while not sum(fields[f"{Level.LOW}_sampled"] for fields in _drain(statistics_box)):
                _push(crews, service, 0.5)
            time.sleep(2.0)  # the learner catches up, so that credit is left when it stalls
            os.kill(learner.pid, signal.SIGSTOP)
            before = {crew.level: crew.produced for crew in crews}
            resident = _push(crews, service, seconds)
        finally:
            learner.kill()
            learner.join()
            transport.close()
    last_report = _drain(statistics_box)[-1]
    rings = last_report["low_bytes"] + last_report["high_bytes"]
    budget = idle + 2 * rings + MAILBOXES * config.transport.mailbox_bytes
    tenth = len(resident) // 10
    first, last = (statistics.mean(part) for part in (resident[tenth : 2 * tenth], resident[-tenth:]))
    figures = {f"{crew.level}_pushed_while_stalled": crew.produced - before[crew.level] for crew in crews}
    figures |= {f"{level}_samples_per_insert": last_report[f"{level}_samples_per_insert"] for level in Level}
    figures |= {"idle_mib": idle / MIB, "rings_mib": rings / MIB, "journal_mib": last_report["journal_bytes"] / MIB}
    figures |= {"budget_mib": budget / MIB, "most_mib": max(resident) / MIB, "pushed_for_s": seconds}
    report("stalled", figures, {"budget_vs_most": budget / max(resident), "last_tenth_vs_second": last / first})


def _learn(endpoint: str, config: Config) -> None:
    """Take batches of both levels until the process is stopped."""
    transport = ZenohTransport(endpoint)
    samplers = [Sampler(transport, config.transport.mailbox_bytes, level) for level in Level]
    while True:
        if not any([sampler.step() is not None for sampler in samplers]):
            time.sleep(0.01)


def _drain(statistics_box: Mailbox) -> list[dict]:
    """Return the replay's reports since the last call."""
    return [json.loads(message.payload) for message in statistics_box.drain()]


def _push(crews: list[Actors], service: ReplayService, seconds: float) -> list[int]:
    """Push for some seconds; return the resident bytes of the replay, 20 times a second."""
    resident: list[int] = []
    began_s = time.monotonic()
    while (passed_s := time.monotonic() - began_s) < seconds:
        if not any([crew.step(AHEAD) for crew in crews]):
            time.sleep(0.001)
        if passed_s * 20 > len(resident):
            resident.append(service.resident_bytes())
    return resident


if __name__ == "__main__":
    main()
