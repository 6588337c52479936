"""A run as the page shows it live: connected, and asking for cars, only while somebody looks."""

import json
import threading
import time
from collections.abc import Callable
from contextlib import closing
from typing import Any

from zsdist.errors import RunError, TransportError
from zsdist.telemetry import watching
from zsdist.telemetry.display import DONE, MAILBOX_BYTES
from zsdist.telemetry.snapshot import Fields, Snapshot
from zsdist.transport.base import Mailbox, Message, Transport
from zsdist.wire import keys

EVERY_S = 0.5  # of new figures, and of questions for cars
LOOKING_S = 5.0  # a page asks twice a second; so long after its last question nobody looks any more
RETRY_EVERY_S = 1.0
ANSWER_WITHIN_S = 2.0
OLD_AFTER_S = 3.0  # cars whose actor has not answered for so long are not shown any more
MOST_VIEWS = 4  # cars that are looked at closely at a time, on all pages
MOST_BYTES = 2 * 2**20  # of one answer
ALL = "all"  # in place of a car: where all of an actor's cars are
TELLING = {  # figures of a role that the page shows
    "actor": ("env_steps", "cars_driving", "cars_waiting_credit", "waiting_credit_s", "weights_max_lag_s"),
    "learner": ("learner_updates", "loss", "weight_version", "waiting_data_s"),
    "replay": ("high_size", "low_size", "low_samples_per_insert", "journal_bytes"),
    "scheduler": ("stage", "episodes", "merges", "restarts"),
    "hub": ("endpoint", "cpu_s"),
}


class LiveRun:
    """One run that may be looked at. Its thread lives while somebody looks.

    Args:
        title: name of the run for people.
        connect: returns the run's name on the key space and a connection to its hub, or raises what is missing.
        attend: returns what is added to a close look at a car, such as attention; called on the run's thread.
    """

    def __init__(
        self,
        title: str,
        connect: Callable[[], tuple[str, Transport]],
        attend: Callable[[dict[str, Any]], dict[str, Any]] = lambda view: {},
    ) -> None:
        self.title, self._connect, self._attend = title, connect, attend
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._looked_s = 0.0  # monotonic time of the last look
        self._views: dict[str, float] = {}  # cars that are looked at closely, with the time of the last look
        self._forget()

    def look(self, car: str = "") -> bytes:
        """Return the newest state as JSON, and keep it up to date for a while.

        Args:
            car: car to look at closely, such as `actor-0/2`; empty: none.
        """
        with self._changed:
            self._wake(car)
            view = self._details.get(car, b"null")
            return b'{"state":%b,"view":%b}' % (self._state, view)

    def snapshot(self, within_s: float) -> dict[str, Any]:
        """Return what `zsdist.monitor --once --json` prints.

        Args:
            within_s: seconds to wait until every living role has reported.

        Raises:
            RunError: the run cannot be watched now, or none of its roles has reported.
        """
        with self._changed:
            self._wake("")
            self._changed.wait_for(self._is_known, within_s)
            if not self._snapshot.roles:
                raise RunError(self._told or f"no role of run {self.title!r} reported within {within_s:g} s")
            return watching.snapshot_fields(self._run, self._snapshot)

    @property
    def watched(self) -> bool:
        """True while it is connected, or tries to be."""
        return self._thread is not None

    def _wake(self, car: str) -> None:
        now = time.monotonic()
        self._looked_s = now
        if car and (car in self._views or len(self._views) < MOST_VIEWS):
            self._views[car] = now
        if self._thread is None:
            self._thread = threading.Thread(target=self._watch, name=f"watch-{self.title}", daemon=True)
            self._thread.start()

    def _forget(self) -> None:
        self._run, self._told = self.title, ""
        self._snapshot = Snapshot()
        self._heard_s: dict[tuple[str, str], tuple[Fields, float]] = {}
        self._cars: dict[str, tuple[bytes, float]] = {}  # quoted answers of actors, with the time
        self._details: dict[str, bytes] = {}
        self._state = json.dumps({"run": self.title, "status": "connecting", "told": ""}).encode()

    def _is_known(self) -> bool:
        return bool(self._told) or (bool(self._snapshot.alive) and self._snapshot.alive <= set(self._snapshot.roles))

    @property
    def _looked_at(self) -> bool:
        return time.monotonic() - self._looked_s < LOOKING_S

    def _seen(self) -> bool:
        """Return whether somebody looks; where nobody does, the next look begins another thread."""
        with self._changed:
            if self._looked_at:
                return True
            self._forget()
            self._thread = None
            return False

    def _watch(self) -> None:
        while self._seen():
            try:
                run, transport = self._connect()
                with closing(transport):
                    self._follow(run, transport)
            except (RunError, TransportError) as error:
                with self._changed:
                    self._forget()
                    self._told = str(error)
                    self._state = _state(run=self.title, status="waiting", told=self._told)
                    self._changed.notify_all()
                time.sleep(RETRY_EVERY_S)

    def _follow(self, run: str, transport: Transport) -> None:
        """Receive until nobody looks, or until the run is silent for long."""
        reports, answers = Mailbox(MAILBOX_BYTES), Mailbox(MAILBOX_BYTES)
        with self._changed:
            self._forget()
            self._run = run
        transport.subscribe(keys.stats(run, keys.ANY, keys.ANY), reports)
        transport.subscribe(keys.events(run), reports)
        transport.watch_alive(keys.alive(run, keys.ANY, keys.ANY), reports)
        heard_s = time.monotonic()
        while self._looked_at:
            before_s = time.monotonic()
            with self._changed:
                reported = self._snapshot.reports
                self._receive(reports.drain())
                heard_s = before_s if self._snapshot.reports > reported else heard_s
                silent_s = before_s - heard_s
                self._state = self._make_state(silent_s)
                self._changed.notify_all()
            views = self._take(answers.drain())
            with self._changed:
                now = time.monotonic()
                self._views = {car: at_s for car, at_s in self._views.items() if now - at_s < LOOKING_S}
                self._details = {car: view for car, view in (self._details | views).items() if car in self._views}
                wanted = [f"{actor}/{ALL}" for actor in self._actors()] + list(self._views)
            if silent_s > watching.GONE_AFTER_S:
                return
            for name in wanted:
                transport.request(keys.view(run, *name.split("/")), b"", answers, timeout_s=ANSWER_WITHIN_S)
            time.sleep(max(0.0, EVERY_S - (time.monotonic() - before_s)))

    def _receive(self, messages: list[Message]) -> None:
        self._snapshot.update(messages)
        now = time.monotonic()
        for role, fields in self._snapshot.roles.items():
            if role not in self._heard_s or self._heard_s[role][0] is not fields:
                self._heard_s[role] = fields, now

    def _take(self, messages: list[Message]) -> dict[str, bytes]:
        """Keep where cars are, and return the close looks at cars."""
        views, now = {}, time.monotonic()
        for message in messages:
            parsed = keys.parse(message.key)
            if parsed is None:
                continue
            actor, car = parsed.fields["actor"], parsed.fields["car"]
            if car == ALL:
                if (quoted := quote(message.payload)) is not None:
                    self._cars[actor] = quoted, now
            elif (content := read_answer(message.payload)) is not None:
                content |= self._attend(content)
                views[f"{actor}/{car}"] = json.dumps(content, separators=(",", ":")).encode()
        return views

    def _actors(self) -> list[str]:
        return sorted(f"actor-{identifier}" for role, identifier in self._snapshot.alive if role == "actor")

    def _make_state(self, silent_s: float) -> bytes:
        """Return everything but close looks as JSON."""
        snapshot, now = self._snapshot, time.monotonic()
        done = any(fields.get("stage") == DONE for fields in snapshot.of("scheduler").values())
        roles: list[dict[str, Any]] = [
            {
                "role": role,
                "id": identifier,
                "alive": (role, identifier) in snapshot.alive,
                "host": fields.get("host", ""),
                "silent_s": round(now - self._heard_s[role, identifier][1], 1),
                "figures": {name: fields[name] for name in TELLING.get(role, ()) if name in fields},
            }
            for (role, identifier), fields in sorted(snapshot.roles.items())
        ]
        known = {(role["role"], role["id"]) for role in roles}
        roles += [
            {"role": role, "id": identifier, "alive": True, "host": "", "silent_s": None, "figures": {}}
            for role, identifier in sorted(snapshot.alive - known)
        ]
        state = _state(
            run=self.title,
            key=self._run,
            status="ended" if done else "live",
            told="",
            silent_s=round(silent_s, 1),
            figures=snapshot.row(),
            waits=snapshot.waits(),
            roles=roles,
            events=snapshot.events[-30:],
        )
        cars = b",".join(answer for answer, at_s in self._cars.values() if now - at_s < OLD_AFTER_S)
        return state[:-1] + b',"actors":[%b]}' % cars


def quote(payload: bytes) -> bytes | None:
    """Return an answer as a text in JSON, which the page reads by itself; None where it is too long or no text.

    Reading the answers of all actors here would cost more than all else.
    """
    try:
        return json.dumps(payload.decode()).encode() if len(payload) <= MOST_BYTES else None
    except UnicodeDecodeError:
        return None


def read_answer(payload: bytes) -> dict[str, Any] | None:
    """Return a JSON object of bounded size and finite numbers; None where the payload is none."""
    try:
        content = json.loads(payload, parse_constant=_refuse) if len(payload) <= MOST_BYTES else None
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is no number of JSON")


def _state(**fields: Any) -> bytes:
    return json.dumps(fields, allow_nan=False, separators=(",", ":")).encode()
