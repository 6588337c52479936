"""Process of one actor that joins a run from elsewhere, and what it says to the command that started it."""

import os
import threading
import time
import traceback
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from multiprocessing.connection import Connection
from typing import Any, Literal, TypeVar

from zsdist.errors import DecodeError, TransportError, ZsdistError
from zsdist.roles import schemas
from zsdist.roles.actor import Actor
from zsdist.roles.schemas import Content, JoinRequest, JoinVerdict
from zsdist.run import preflight
from zsdist.run.allocator import keep_freed_memory
from zsdist.run.program import RoleSpec, RunSpec
from zsdist.transport.base import Mailbox, Transport
from zsdist.wire import addresses, codec, keys
from zsdist.wire.messages import Admission

ASK_EVERY_S = 1.0  # a question without an answer is asked again
REPORT_EVERY_S = 1.0
LEAVE_WITHIN_S = 8.0  # time to deliver what was driven, once the process has been asked to leave
GOODBYE_WITHIN_S = 1.5
UNNAMED_S = 5.0  # time without being named in the run's orders after which the run has another actor of this name

Answer = TypeVar("Answer", bound=Content)


class Ending(StrEnum):
    """Reasons for which the process of an actor ends."""

    ENDED = "ended"  # the run has ended, and everything is delivered
    LEFT = "left"  # it was asked to
    REFUSED = "refused"  # another process has its name
    DISMISSED = "dismissed"  # the run has given it up, or was started again
    UNREACHABLE = "unreachable"  # no hub answers
    FAILED = "failed"  # an error that a new process would meet too


@dataclass(frozen=True)
class GuestReport:
    """Word of the process to its parent.

    Attributes:
        ending: why it ends; None: it does not.
        reason: reason in one line, of an ending that has one.
        episodes: number of training episodes that it has finished.
        env_steps: number of steps that its cars have made.
    """

    ending: Ending | None = None
    reason: str = ""
    episodes: int = 0
    env_steps: int = 0


class Doorbell:
    """Questions of one process to a run, under the name of an actor.

    Args:
        transport: transport with the right to ask under this name.
        run: name of the run.
        actor: name of the actor.
        joiner: word of the command.
    """

    def __init__(self, transport: Transport, run: str, actor: str, joiner: str) -> None:
        self._transport, self._run, self._actor, self._joiner = transport, run, actor, joiner
        self._process = uuid.uuid4().hex
        self._answered = threading.Event()
        self._answers = Mailbox(4 * 2**20, self._answered.set)

    def ask(
        self,
        what: Literal["terms", "epoch", "leave"],
        model: type[Answer],
        within_s: float,
        give_up: Callable[[], bool] = lambda: False,
    ) -> Answer | None:
        """Return the answer; None where none came in time, or `give_up` has returned true."""
        request = JoinRequest(ask=what, joiner=self._joiner, process=self._process)
        payload = codec.encode(Admission(self._actor, request.model_dump()))
        key, end_s, ask_s = keys.join(self._run, self._actor), time.monotonic() + within_s, 0.0
        while not give_up() and (now := time.monotonic()) < end_s:
            if now >= ask_s:
                ask_s = now + ASK_EVERY_S
                self._transport.request(key, payload, self._answers, timeout_s=ASK_EVERY_S)
            self._answered.wait(0.1)
            self._answered.clear()
            for message in self._answers.drain():
                try:
                    admission = codec.decode(message.payload, expect=Admission)
                    addresses.require(message.key, self._run, admission)
                    return schemas.read(model, admission.content)
                except DecodeError:
                    continue  # an answer to an earlier question of another kind; this one is asked again
        return None


class GuestProcess:
    """One actor in a process of its own: it prepares, asks for an epoch, drives, and leaves.

    Args:
        spec: specification of the run, with this machine's certificates.
        identifier: number of the actor.
        endpoint: endpoint of the hub.
        joiner: word of the command.
        parent: connection to the command; a word or the end of it asks this process to leave.
    """

    def __init__(self, spec: RunSpec, identifier: str, endpoint: str, joiner: str, parent: Connection) -> None:
        self._spec, self._endpoint, self._joiner, self._parent = spec, endpoint, joiner, parent
        self._role_spec = RoleSpec("actor", identifier, 0)
        self._wake, self._leaves = threading.Event(), threading.Event()
        self._orphaned = False
        self._last = GuestReport()

    def run(self) -> None:
        """Be an actor until the run ends, or the parent asks to leave, or it is gone; report to the parent."""
        keep_freed_memory()
        threading.Thread(target=self._listen, daemon=True).start()
        try:
            ending, reason = self._take_part()
        except TransportError as error:
            ending, reason = Ending.UNREACHABLE, str(error)
        except ZsdistError as error:
            ending, reason = Ending.FAILED, self._role_spec.reason(error)
        except Exception:
            traceback.print_exc()  # a defect: the parent notices the end of this process, and starts another one
            os._exit(1)
        self._tell(GuestReport(ending, reason, self._last.episodes, self._last.env_steps))

    def _listen(self) -> None:
        """Wait for the parent's word, or its end; end this process where it does not leave in time."""
        try:
            self._parent.recv_bytes()
        except (EOFError, OSError):
            self._orphaned = True
        self._leaves.set()
        self._wake.set()
        time.sleep(LEAVE_WITHIN_S + GOODBYE_WITHIN_S + 2.0)
        os._exit(1)

    def _tell(self, report: GuestReport) -> None:
        self._last = report
        if not self._orphaned:
            try:
                self._parent.send(report)
            except OSError:
                self._orphaned = True  # the listener notices it too, and this process leaves

    def _take_part(self) -> tuple[Ending, str]:
        spec = self._spec
        parts = spec.make_parts(spec.config)
        preflight.try_out(parts, spec.config)
        if self._leaves.is_set():
            return Ending.LEFT, ""
        transport = spec.connect(self._role_spec, self._endpoint)
        try:
            doorbell = Doorbell(transport, spec.run, self._role_spec.name, self._joiner)
            verdict = doorbell.ask("epoch", JoinVerdict, float("inf"), self._leaves.is_set)
            if verdict is None:
                return Ending.LEFT, ""
            if verdict.start != spec.start:
                return Ending.DISMISSED, "the run was started again"
            if verdict.epoch is None:
                return Ending.REFUSED, verdict.reason
            self._role_spec = RoleSpec("actor", self._role_spec.id, verdict.epoch)
            transport.declare_alive(keys.alive(spec.run, "actor", self._role_spec.id))  # many cars take a while
            role = spec.build(self._role_spec, transport, self._wake, parts)
            assert isinstance(role, Actor), "a role called actor is one"
            ending = self._drive(role)
            if ending is not Ending.ENDED:  # then nobody waits for it
                doorbell.ask("leave", JoinVerdict, GOODBYE_WITHIN_S)
            return ending, ""
        finally:
            transport.close()

    def _drive(self, role: Actor) -> Ending:
        """Step the actor to its end, and return the reason of it."""
        offset_s = time.time() - time.monotonic()  # unix time that never runs backwards
        leave_s = named_s = report_s = 0.0
        while (due_s := role.step(now := offset_s + time.monotonic())) is not None:
            if self._leaves.is_set():
                leave_s = leave_s or now + LEAVE_WITHIN_S
                role.leave()
                if now >= leave_s:
                    return Ending.LEFT
            if role.is_named or not named_s:
                named_s = now
            elif now - named_s > UNNAMED_S:
                return Ending.DISMISSED
            if now >= report_s:
                report_s = now + REPORT_EVERY_S
                self._report(role.statistics())
            self._wake.wait(max(0.0, min(due_s, report_s) - now))
            self._wake.clear()
        self._report(role.statistics())
        return Ending.LEFT if self._leaves.is_set() else Ending.ENDED

    def _report(self, fields: dict[str, Any]) -> None:
        self._tell(GuestReport(episodes=int(fields["episodes_produced"]), env_steps=int(fields["env_steps"])))


def work(spec: RunSpec, identifier: str, endpoint: str, joiner: str, parent: Connection) -> None:
    """Begin in a new process."""
    GuestProcess(spec, identifier, endpoint, joiner, parent).run()
