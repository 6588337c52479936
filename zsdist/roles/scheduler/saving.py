"""Saving of a checkpoint beside the scheduler's steps: states are requested, read and written while it goes on."""

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial

from zsdist.errors import DecodeError
from zsdist.roles.base import Role
from zsdist.roles.scheduler.checkpointing import ANSWER_WITHIN_S, Answer, StateCollection, read_answer
from zsdist.telemetry.snapshot import Fields
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders


class Saving:
    """Requests for the states of all roles, their answers, and the last checkpoint while it is written.

    Args:
        role: scheduler, through which messages are sent and in whose background the work is done.
    """

    def __init__(self, role: Role) -> None:
        self._role = role
        self._collection = StateCollection(role.config)
        self._writing: Future[None] | None = None
        self.restart()

    def restart(self) -> None:
        """Forget all answers, and ignore those that are still on their way; what is being written is written."""
        self._answers = self._role.mailbox("checkpoint")
        self._reading: list[Future[Answer | DecodeError]] = []
        self._collection.clear()

    @property
    def has_written(self) -> bool:
        """True unless a checkpoint is being written."""
        return self._writing is None or self._writing.done()

    def statistics(self) -> Fields:
        """Return the names of the roles that have not answered yet, as `states_awaited`."""
        return {**self._collection.statistics()}

    def collect(self, now: float, *, delivered: bool) -> dict[str, Answer] | None:
        """Return the states of all roles and forget them; None while one is missing, and those are requested.

        Args:
            now: time, seconds.
            delivered: whether only states of shards count that expect no more frames.
        """
        self._read()
        if delivered:
            self._collection.drop_open(now)
        answers = self._collection.take()
        if answers is None:
            context = self._role.context
            for name in self._collection.due(now):
                wanted = {"ask": "state", "epoch": self._role.newest_epoch(name)}
                request = codec.encode(Orders(context.epoch, name, wanted))
                where = keys.control(context.run, name)
                self._role.transport.request(where, request, self._answers, timeout_s=ANSWER_WITHIN_S)
        return answers

    def write(self, function: Callable[[], None]) -> None:
        """Begin to write a checkpoint."""
        self._writing = self._role.in_background(function)

    def _read(self) -> None:
        """Take the answers that have been read; begin to read those that have arrived."""
        role, run = self._role, self._role.context.run
        self._reading += [role.in_background(partial(read_answer, message, run)) for message in self._answers.drain()]
        while self._reading and self._reading[0].done():  # they are read in order
            answer = self._reading.pop(0).result()
            if isinstance(answer, DecodeError):
                role.refuse(answer.reason)
            else:
                self._collection.accept(answer)
