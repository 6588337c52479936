"""Joining a run that goes on, with actors in processes of this machine, from any machine that reaches its hub.

No Ray is needed here. The run's runner admits the actors (`zsdist.run.guests`); from then on they are actors like all
others, until they leave or the run ends.
"""

import multiprocessing
import multiprocessing.connection
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from zsdist import __version__, config
from zsdist.common import process_pool, setting_trees
from zsdist.config import Config
from zsdist.errors import RunError, TransportError, WeightsError
from zsdist.roles import permissions
from zsdist.roles.schemas import JoinTerms
from zsdist.run import guest_process, preflight, program
from zsdist.run.guest_process import Doorbell, Ending, GuestReport
from zsdist.run.orders_watch import OrdersWatch
from zsdist.run.program import ActorParts, RunSpec
from zsdist.run.restarts import RESTARTS_ALLOWED
from zsdist.transport import certificates
from zsdist.transport.certificates import Identity
from zsdist.transport.zenoh import ZenohTransport
from zsdist.vision.fingerprint import VisionIdentity

# Settings of this machine, which may differ from the run's, if they fit.
LOCAL_SETTINGS = ("vision.weights", "vision.encoder", "vision.cache_bytes", "vision.device")
TERMS_WITHIN_S = 10.0
QUIET_AFTER_S = 5.0  # the run repeats its orders four times a second
AWAY_S = 600.0  # silence after which the run is given up
STOPPED_AFTER_S = 15.0  # silence of a process that drives after which it is replaced; it reports once a second
EXITS_WITHIN_S = 5.0  # time from the last word of a process to its end
AGAIN_AFTER_S = 1.0  # time until a process that could not take part is replaced
LINE_EVERY_S = 10.0
LEAVE_WITHIN_S = guest_process.LEAVE_WITHIN_S + guest_process.GOODBYE_WITHIN_S

Notify = Callable[[str], None]  # shows one line to the user


@dataclass
class _Slot:
    """Place of one actor, and the process that fills it.

    Attributes:
        name: name of the actor; None: it has to get one.
        process: the process; None: there is none.
        link: connection to it.
        again_s: monotonic time from which on a process is started.
        deaths: number of its processes that died.
        episodes, env_steps: counts of the present process.
        earlier: both counts of the processes before it.
        heard_s: monotonic time of the last report of the present process; None: it has not begun to drive.
        over: whether the run has ended for it.
    """

    name: str | None = None
    process: BaseProcess | None = None
    link: Any = None
    again_s: float = 0.0
    deaths: int = 0
    episodes: int = 0
    env_steps: int = 0
    earlier: tuple[int, int] = (0, 0)
    heard_s: float | None = None
    over: bool = False

    def take(self, report: GuestReport) -> None:
        self.episodes, self.env_steps, self.heard_s = report.episodes, report.env_steps, time.monotonic()

    @property
    def stopped(self) -> bool:
        """True if its process has begun to drive and reports no longer, so that it hangs or was stopped."""
        return self.heard_s is not None and time.monotonic() - self.heard_s > STOPPED_AFTER_S

    def kill(self) -> None:
        """Kill its process; the end of the connection follows."""
        assert self.process is not None, "there is one"
        self.process.kill()

    def clear(self) -> int | None:
        """Forget a process that has ended or is about to; return its exit status."""
        assert self.process is not None, "there was one"
        self.process.join(EXITS_WITHIN_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.link.close()
        status = self.process.exitcode
        self.earlier = (self.earlier[0] + self.episodes, self.earlier[1] + self.env_steps)
        self.process, self.link, self.episodes, self.env_steps, self.heard_s = None, None, 0, 0, None
        self.again_s = time.monotonic() + AGAIN_AFTER_S
        return status


class Party:
    """Actors that one command adds to a run.

    Args:
        endpoint: endpoint of the run's hub.
        tls: folder with certificates of actors; None: the hub asks for none.
        actors: number of actors to add.
        overrides: settings of this machine, `key.path=value`, of `LOCAL_SETTINGS`.
        notify: called with lines for the user.
        make_parts: factory of the parts of an actor.

    Raises:
        TransportError: no hub answers, or a certificate is missing or cannot be used.
        RunError: the hub carries no run, or several.
    """

    def __init__(
        self,
        endpoint: str,
        tls: Path | None,
        actors: int,
        overrides: Sequence[str] = (),
        notify: Notify = lambda line: None,
        make_parts: Callable[[Config], ActorParts] = program.simulation,
    ) -> None:
        self._endpoint, self._tls, self._overrides = endpoint, tls, overrides
        self._notify, self._make_parts = notify, make_parts
        self._names = actor_names(tls, actors)
        self._slots = [_Slot() for _ in range(actors)]
        self._joiner = uuid.uuid4().hex
        self._spec: RunSpec | None = None
        self._told_s = self._begun_s = time.monotonic()
        self._quiet = False

    def take_part(self, interrupted: Callable[[], bool]) -> None:
        """Drive until the run has ended, or an interruption is noticed and everything is delivered.

        Raises:
            ZsdistError: the run does not take these actors, is out of reach for too long, or an actor failed.
        """
        identity = None if self._tls is None else Identity.load(self._tls, self._names[0])
        with closing(ZenohTransport(self._endpoint, identity)) as transport:
            watcher = OrdersWatch(transport)
            run = watcher.find(self._endpoint)
            doorbell = Doorbell(transport, run, self._names[0], self._joiner)
            try:
                terms = doorbell.ask("terms", JoinTerms, TERMS_WITHIN_S, interrupted)
                if interrupted():
                    return
                watcher.update()
                if terms is None or watcher.closing:
                    raise RunError(f"run {run} at {self._endpoint} takes no more actors; it is ending, or is stopped")
                self._check_places(terms)
                self._prepare(terms)
                self._notify(f"joining run {run} with {len(self._slots)} actors")
                while not interrupted():
                    watcher.update()
                    if self._is_over(run, watcher):
                        return
                    self._fill(doorbell, watcher, interrupted)
                    self._hear(0.25)
                    self._show(watcher)
                self._leave()
                self._notify(f"left run {run}; {self._counts()}")
            finally:
                self._end()

    # -- terms --------------------------------------------------------------------------------------------------

    def _prepare(self, terms: JoinTerms) -> None:
        """Check that this machine can drive for the run; again only where the run was started again since."""
        if self._spec is not None and self._spec.start == terms.start:
            return
        if terms.version != __version__:
            raise RunError(
                f"run {terms.run} is driven by zsdist {terms.version} and this is zsdist {__version__}; "
                f"allowed is the version of the run"
            )
        settings = self._settings(terms)
        self._notify("preparing; the first time this takes about 15 s, for compilation")
        parts = self._make_parts(settings)
        preflight.try_out(parts, settings)
        here = VisionIdentity.of(parts.visual_act, settings.vision.network)
        there = VisionIdentity.from_json(terms.vision)
        if here != there:
            raise WeightsError(
                f"the vision model here is {here}; allowed is that of run {terms.run}, {there}: name the folder of its "
                "weights with --set vision.weights=DIR"
            )
        self._spec = RunSpec(settings, terms.run, Path(), {}, there, self._make_parts, terms.start)

    def _settings(self, terms: JoinTerms) -> Config:
        """Return the run's configuration as it holds here: with this machine's connection, and its local settings."""
        tree = dict(terms.settings)
        transport = {"kind": "zenoh", "endpoint": self._endpoint, "tls": None if self._tls is None else str(self._tls)}
        tree["transport"] = {**tree.get("transport", {}), **transport}
        tree["run"] = {**tree.get("run", {}), "address": None}
        for override in self._overrides:
            setting_trees.apply(tree, override, Config, config.SHORT_FORMS)
        return config.parse(tree)

    def _check_places(self, terms: JoinTerms) -> None:
        free = [name for name in self._names if name not in terms.taken]
        if len(free) < len(self._slots):
            whose = "" if self._tls is None else f" with a certificate in {self._tls}"
            raise RunError(
                f"--actors is {len(self._slots)}; allowed is at most {len(free)}: of the {len(self._names)} actors"
                f"{whose}, {len(self._names) - len(free)} take part in run {terms.run} already"
            )

    # -- processes ----------------------------------------------------------------------------------------------

    def _fill(self, doorbell: Doorbell, watcher: OrdersWatch, interrupted: Callable[[], bool]) -> None:
        """Start a process in each place that has none."""
        now = time.monotonic()
        empty = [slot for slot in self._slots if slot.process is None and not slot.over and now >= slot.again_s]
        if not empty or watcher.silent_s > QUIET_AFTER_S:
            return
        terms = doorbell.ask("terms", JoinTerms, 2.0, interrupted)
        if terms is None:
            return
        self._prepare(terms)
        mine = {slot.name for slot in self._slots}
        free = (name for name in self._names if name not in terms.taken and name not in mine)
        for slot in empty:
            slot.name = slot.name or next(free, None)
            if slot.name is None:
                slot.again_s = now + AGAIN_AFTER_S  # all are taken for the moment
                continue
            self._start(slot, slot.name)

    def _start(self, slot: _Slot, name: str) -> None:
        context = multiprocessing.get_context("spawn")
        slot.link, theirs = context.Pipe()
        identifier = str(permissions.actor_number(name))
        arguments = (self._spec, identifier, self._endpoint, self._joiner, theirs)
        slot.process = context.Process(target=guest_process.work, args=arguments, name=name)
        process_pool.start(slot.process)
        theirs.close()  # so that the end of the process ends the connection

    def _hear(self, timeout_s: float) -> None:
        """Receive the reports of the processes, and notice their ends."""
        links = {slot.link: slot for slot in self._slots if slot.link is not None}
        if not links:
            time.sleep(timeout_s)
            return
        ready = multiprocessing.connection.wait(list(links), timeout_s)
        for slot in (slot for link, slot in links.items() if link not in ready and slot.stopped):
            self._notify(f"{slot.name} has not reported for {STOPPED_AFTER_S:g} s; it is killed")
            slot.kill()
        for link in ready:
            slot = links[link]
            try:
                report = slot.link.recv()
            except (EOFError, OSError):
                self._mourn(slot)
                continue
            slot.take(report)
            if report.ending is not None:
                slot.clear()
                self._account_for(slot, report)

    def _account_for(self, slot: _Slot, report: GuestReport) -> None:
        match report.ending:
            case Ending.FAILED:
                raise RunError(report.reason)
            case Ending.ENDED | Ending.LEFT:
                slot.over = True
            case Ending.REFUSED:
                self._notify(f"{slot.name} was refused: {report.reason}; another name is tried")
                slot.name = None
            case Ending.DISMISSED:
                self._notify(f"{slot.name} takes no part in the run any longer; it asks again")
            case _:
                self._notify(f"{slot.name}: {report.reason}")

    def _mourn(self, slot: _Slot) -> None:
        """Handle a process that has died without a word."""
        reason = f"{slot.name} died: exit status {slot.clear()}"
        slot.deaths += 1
        if slot.deaths > RESTARTS_ALLOWED:
            raise RunError(f"{reason}; it had been restarted {RESTARTS_ALLOWED} times")
        self._notify(f"{reason}; a new process takes its place")

    def _leave(self) -> None:
        """Ask all processes to leave, and wait until they have."""
        for slot in self._slots:
            if slot.link is not None:
                try:
                    slot.link.send_bytes(b"leave")
                except OSError:
                    continue  # it has ended
        end_s = time.monotonic() + LEAVE_WITHIN_S
        while any(slot.process for slot in self._slots) and time.monotonic() < end_s:
            self._hear(0.25)

    def _end(self) -> None:
        """End all processes that are left."""
        for slot in self._slots:
            if slot.process is not None:
                slot.kill()
                slot.clear()

    # -- the run ------------------------------------------------------------------------------------------------

    def _is_over(self, run: str, watcher: OrdersWatch) -> bool:
        """Return whether the run has ended for these actors.

        Raises:
            RunError: it has been silent for too long.
        """
        silent_s = watcher.silent_s
        done = all(slot.over or (slot.process is None and watcher.closing) for slot in self._slots)
        if done or (watcher.closing and silent_s > QUIET_AFTER_S):
            self._notify(f"run {run} has ended; {self._counts()}")
            return True
        if silent_s > QUIET_AFTER_S and watcher.runs and run not in watcher.runs:
            self._notify(f"run {run} is gone, its hub carries {', '.join(sorted(watcher.runs))}; {self._counts()}")
            return True
        if silent_s > AWAY_S:
            raise RunError(
                f"run {run} at {self._endpoint} has been silent for {AWAY_S:g} s; it was killed, or it cannot be "
                f"reached from here; {self._counts()}"
            )
        if (silent_s > QUIET_AFTER_S) != self._quiet:
            self._quiet = not self._quiet
            self._notify(
                f"run {run} is silent; waiting up to {AWAY_S:g} s for its hub" if self._quiet else f"run {run} is back"
            )
        return False

    def _show(self, watcher: OrdersWatch) -> None:
        now = time.monotonic()
        if now - self._told_s < LINE_EVERY_S or self._spec is None:
            return
        self._told_s = now
        running = sum(slot.process is not None for slot in self._slots)
        whole = f"{watcher.finished} of {self._spec.config.run.episodes} episodes of the run"
        self._notify(f"[{now - self._begun_s:6.1f} s] actors {running}  {whole}  {self._counts()}")

    def _counts(self) -> str:
        episodes = sum(slot.earlier[0] + slot.episodes for slot in self._slots)
        env_steps = sum(slot.earlier[1] + slot.env_steps for slot in self._slots)
        return f"{episodes} episodes and {env_steps} steps driven here"


def actor_names(tls: Path | None, actors: int) -> list[str]:
    """Return the names that actors here may have, in order: those with a certificate, or all where none are needed.

    Raises:
        TransportError: there are fewer certificates than actors, or one cannot be used.
    """
    if tls is None:
        return [permissions.actor_name(number) for number in range(permissions.MAX_ACTORS)]
    names = sorted(filter(permissions.is_actor_name, certificates.names(tls)), key=permissions.actor_number)
    if len(names) < actors:
        raise TransportError(
            f"{tls} has certificates of {len(names)} actors and --actors is {actors}; make more with "
            "python -m zsdist.certs, and copy ca.pem and the files actor-N.* here"
        )
    for name in names:
        Identity.load(tls, name)
    return names
