"""Inbox of the actors' records, which accepts a frame only if the scheduler can read all of its records."""

from collections.abc import Callable

from zsdist.errors import DecodeError
from zsdist.protocol.inbox import Inbox
from zsdist.roles import schemas
from zsdist.wire.messages import Records


class RecordsInbox(Inbox[Records]):
    """Inbox of one stream of records.

    Args:
        stream: name of the stream.
        sender_epoch: incarnation of the scheduler.
        refuse: function that counts a refused frame by its reason; its actor is told too, and sends it again.
    """

    def __init__(self, stream: str, sender_epoch: int, refuse: Callable[[str], None]) -> None:
        super().__init__(stream, sender_epoch=sender_epoch)
        self._count_refusal = refuse

    def receive(self, frame: Records, now: float) -> list[Records]:
        """Accept a frame and return the frames that can be delivered now; none where a record does not fit."""
        try:
            schemas.check_records(frame)
        except DecodeError as error:
            self._count_refusal(error.reason)
            self.note_refusal(frame.actor, frame.epoch, str(error))
            return []
        return super().receive(frame, now)
