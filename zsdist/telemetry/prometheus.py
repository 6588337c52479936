"""Statistics of a run for Prometheus: what any subscriber receives, as metrics over HTTP.

A field `NAME` of the statistics of a role becomes the metric `zsdist_ROLE_NAME`, with the run, the host and the id of
the role as labels. A name that begins with a level has the level as a label instead. Seconds end in `_seconds`, sizes
in `_bytes`, and counters, which fall only where a role is replaced, in `_total`. A role that is silent for
`SILENT_AFTER_S` has no metrics any more.
"""

import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from types import TracebackType
from wsgiref.simple_server import WSGIServer

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

from zsdist.common.console import say
from zsdist.common.http_address import HttpAddress
from zsdist.errors import RunError, TransportError
from zsdist.telemetry.display import DONE, MAILBOX_BYTES
from zsdist.telemetry.snapshot import Fields, Snapshot
from zsdist.transport.base import Mailbox, Transport
from zsdist.types import Level
from zsdist.wire import keys

PAGE = "metrics"
SILENT_AFTER_S = 30.0
RETRY_EVERY_S = 2.0
RECEIVE_EVERY_S = 0.2
COUNTERS = frozenset(  # fields that only grow while a process lives; those of `_COUNTER_PREFIXES` are counters too
    (
        *("env_steps", "actions", "started_episodes", "waiting_credit_s", "cache_hits", "cache_misses"),
        *("cache_bypasses", "produced", "sent_frames", "resent_frames", "ignored_acks"),  # actor
        *("learner_updates", "rollbacks", "waiting_data_s", "waiting_reply_s"),  # learner
        *("stored", "duplicates", "rejected", "lost", "lost_rows", "sampled", "updates_served", "recovered_frames"),
        *("episodes", "merges", "restarts", "success", "collision", "timeout"),  # scheduler
        "cpu_s",  # hub
    )
)
_COUNTER_PREFIXES = ("rejected_", "refused_", "mailbox_", "episodes_sent_", "episodes_resent_", "episodes_ignored_")
_ABOUT = ("time_s", "role", "id", "host", "pid", "epoch")  # fields that say who reports and when
_WITH_LEVEL = ("actor", "replay", "learner")  # roles whose metrics have a level
_NAME = re.compile(r"[a-z][a-z0-9_]{0,79}")
_Family = GaugeMetricFamily | CounterMetricFamily


class Gauges(Collector):
    """Metrics of one run at a time; safe to collect while another thread receives."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._run: str | None = None
        self._snapshot = Snapshot()
        self._mailbox = Mailbox(MAILBOX_BYTES)
        self._heard_s: dict[tuple[str, str], tuple[Fields, float]] = {}  # newest statistics and when they came
        self._events: Counter[str] = Counter()
        self._last_event: Fields | None = None

    def watch(self, run: str, transport: Transport) -> None:
        """Subscribe to a run, and forget the one before; counts of events go on."""
        with self._lock:
            self._run, self._snapshot, self._mailbox = run, Snapshot(), Mailbox(MAILBOX_BYTES)
            self._heard_s, self._last_event = {}, None
        transport.subscribe(keys.stats(run, keys.ANY, keys.ANY), self._mailbox)
        transport.subscribe(keys.events(run), self._mailbox)
        transport.watch_alive(keys.alive(run, keys.ANY, keys.ANY), self._mailbox)

    def leave(self) -> None:
        """Forget the run."""
        with self._lock:
            self._run = None

    def receive(self) -> None:
        """Take over what has arrived."""
        with self._lock:
            self._snapshot.update(self._mailbox.drain())
            now = time.monotonic()
            for role, fields in self._snapshot.roles.items():
                if role not in self._heard_s or self._heard_s[role][0] is not fields:
                    self._heard_s[role] = fields, now
            self._count_events()

    @property
    def done(self) -> bool:
        """True if the scheduler has reported the end of the run."""
        return any(fields.get("stage") == DONE for fields in self._snapshot.of("scheduler").values())

    def silent_since(self, start_s: float) -> float:
        """Return the monotonic time of the last report of a role, and at least `start_s`."""
        return max((at_s for _, at_s in self._heard_s.values()), default=start_s)

    def collect(self) -> Iterator[_Family]:
        """Return all metrics; called by the server, on a thread of its own, for each reading."""
        with self._lock:
            families = dict[str, _Family]()
            run = self._run
            watched = run is not None and bool(self._fresh())
            families["zsdist_up"] = GaugeMetricFamily("zsdist_up", "1 while roles of a run report.", float(watched))
            if run is not None:
                self._add_roles(families, run)
                self._add_life(families, run)
        return iter(families.values())

    def _fresh(self) -> dict[tuple[str, str], Fields]:
        """Return the statistics of the roles that have reported lately."""
        now = time.monotonic()
        return {role: fields for role, (fields, at_s) in self._heard_s.items() if now - at_s < SILENT_AFTER_S}

    def _add_roles(self, families: dict[str, _Family], run: str) -> None:
        for (role, identifier), fields in sorted(self._fresh().items()):
            host = str(fields.get("host", ""))
            for field, value in fields.items():
                if field in _ABOUT or isinstance(value, str) or not _NAME.fullmatch(field):
                    continue
                level, name = _level(role, identifier, field)
                family, factor = _family(families, role, name)
                labels = [run, host, identifier, *((level,) if role in _WITH_LEVEL else ())]
                family.add_metric(labels, float(value) * factor)

    def _add_life(self, families: dict[str, _Family], run: str) -> None:
        alive = GaugeMetricFamily("zsdist_role_alive", "1 for each role that is alive.", labels=["run", "role", "id"])
        for role, identifier in sorted(self._snapshot.alive):
            alive.add_metric([run, role, identifier], 1.0)
        stage = GaugeMetricFamily("zsdist_run_stage", "1 for the stage of the run.", labels=["run", "stage"])
        for fields in self._snapshot.of("scheduler").values():
            if "stage" in fields:
                stage.add_metric([run, str(fields["stage"])], 1.0)
        lag = GaugeMetricFamily(
            "zsdist_weight_lag_versions",
            "Versions by which the oldest weights in use are behind their learner.",
            labels=["run", "level"],
        )
        for level, versions in self._snapshot.lag_versions().items():
            lag.add_metric([run, level.value], float(versions))
        events = CounterMetricFamily("zsdist_events", "Events since this process watches.", labels=["event"])
        for name, count in sorted(self._events.items()):
            events.add_metric([name], float(count))
        families |= {family.name: family for family in (alive, stage, lag, events)}

    def _count_events(self) -> None:
        news = self._snapshot.events
        if self._last_event is not None and (seen := [at for at, e in enumerate(news) if e is self._last_event]):
            news = news[seen[-1] + 1 :]
        for event in news:
            self._last_event = event
            if _NAME.fullmatch(name := str(event.get("event", ""))) and len(self._events) < 1000:
                self._events[name] += 1


def _level(role: str, identifier: str, field: str) -> tuple[str, str]:
    """Return the level of a field, empty where it has none, and the rest of its name."""
    if role == "learner":
        return identifier, field
    for level in Level if role in _WITH_LEVEL else ():
        if field.startswith(f"{level.value}_"):
            return level.value, field.removeprefix(f"{level.value}_")
    return "", field


def _family(families: dict[str, _Family], role: str, field: str) -> tuple[_Family, float]:
    """Return the family of a field, and the factor that brings its values into the base unit."""
    name, factor = f"zsdist_{role}_{field}", 1.0
    if name.endswith("_s"):
        name = f"{name}econds"
    elif name.endswith("_kib"):
        name, factor = f"{name.removesuffix('_kib')}_bytes", 1024.0
    if name not in families:
        counts = field in COUNTERS or field.startswith(_COUNTER_PREFIXES)
        kind = CounterMetricFamily if counts else GaugeMetricFamily
        labels = ["run", "host", "id", *(("level",) if role in _WITH_LEVEL else ())]
        families[name] = kind(name, f"{field} in the statistics of each {role}.", labels=labels)
    return families[name], factor


class Exporter:
    """Server of a run's metrics, as a context manager.

    Raises:
        RunError: it cannot listen at the address.
    """

    def __init__(self, where: HttpAddress) -> None:
        self.where = where
        self._gauges = Gauges()
        registry = CollectorRegistry()
        registry.register(self._gauges)
        self._server: WSGIServer
        try:
            self._server, self._thread = start_http_server(where.port, where.host, registry)
        except OSError as error:
            raise RunError(
                f"metrics cannot be served at {where.url(PAGE)}: {error.strerror}; allowed are a free port and an "
                "address of this machine"
            ) from error

    def __enter__(self) -> "Exporter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def serve(self, find: Callable[[], tuple[str, Transport]], over: Callable[[], bool] = lambda: False) -> None:
        """Watch one run after the other, and wait where there is none.

        Args:
            find: returns the name of a run and a connection to its hub, or raises what is missing.
            over: tells whether to return.
        """
        told = ""
        while not over():
            try:
                run, transport = find()
            except (RunError, TransportError) as error:
                if str(error) != told:
                    told = str(error)
                    say(f"waiting: {told}", error=True)
                time.sleep(RETRY_EVERY_S)
                continue
            told = ""
            with closing(transport):
                say(f"run {run} is watched")
                self._follow(run, transport, over)
            say(f"run {run} {'has ended' if self._gauges.done else 'is silent'}")
            time.sleep(RETRY_EVERY_S)  # for its hub to go

    def _follow(self, run: str, transport: Transport, over: Callable[[], bool]) -> None:
        """Receive from a run until it ends or is silent."""
        self._gauges.watch(run, transport)
        start_s = time.monotonic()
        while not over():
            self._gauges.receive()
            if self._gauges.done or time.monotonic() - self._gauges.silent_since(start_s) > SILENT_AFTER_S:
                break
            time.sleep(RECEIVE_EVERY_S)
        self._gauges.leave()
