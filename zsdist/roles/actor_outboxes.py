"""Outboxes of an actor, one for each stream, and the credit that its cars have reserved at the replay."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from zsdist.config import TransportConfig
from zsdist.errors import ProtocolError, RunError
from zsdist.protocol.outbox import Outbox
from zsdist.transport.base import Transport
from zsdist.types import Ack, Level, Trajectory
from zsdist.wire import codec, keys
from zsdist.wire.messages import EPISODES, EVALUATION, Push, Records

_CONTENT: dict[str, str] = {level: f"transitions of the {level} level" for level in Level} | {
    EPISODES: "records of finished episodes",
    EVALUATION: "results of validation drives",
}


@dataclass
class CreditAccount:
    """Credit of one car in each level.

    Attributes:
        reserved: number of transitions whose credit is reserved and not yet used up.
        pending: number of transitions that were driven and whose trajectory is not complete yet.
    """

    reserved: dict[Level, int] = field(default_factory=lambda: dict.fromkeys(Level, 0))
    pending: dict[Level, int] = field(default_factory=lambda: dict.fromkeys(Level, 0))

    def count_step(self) -> None:
        """Count one driven step, which is a transition of each level."""
        for level in Level:
            self.pending[level] += 1


class ActorOutboxes:
    """Outboxes of one incarnation of an actor: trajectories of both levels, episodes, and drives of candidates.

    Args:
        run: name of the run on the key space.
        actor: name of the actor.
        epoch: epoch of the actor.
        settings: window and times of the push protocol.
    """

    def __init__(self, run: str, actor: str, epoch: int, settings: TransportConfig) -> None:
        self._actor, self._give_up_after_s = actor, settings.give_up_after_s
        self._keys: dict[str, str] = {level: keys.push(run, level, actor, epoch) for level in Level}
        self._keys[EPISODES] = keys.episodes(run, actor, epoch)
        self._keys[EVALUATION] = keys.evaluation(run, actor)
        self._outboxes = {
            stream: Outbox(
                stream,
                actor,
                epoch,
                window_frames=settings.window_frames,
                resend_after_s=settings.resend_after_s,
                give_up_after_s=settings.give_up_after_s,
                make_frame=Push if isinstance(stream, Level) else Records,
            )
            for stream in self._keys
        }

    @property
    def drained(self) -> bool:
        """True once all outboxes are closed and their receivers hold everything."""
        return all(outbox.drained for outbox in self._outboxes.values())

    def on_ack(self, ack: Ack, now: float) -> None:
        """Process an acknowledgement of one of the streams."""
        self._outboxes[ack.stream].on_ack(ack, now)

    def reserve(self, account: CreditAccount) -> bool:
        """Reserve credit for one more transition of each level before it is driven, so that flushing never has to wait.

        The replay grants a stream at least one whole option per car beyond what it holds, so every option can end.

        Returns:
            Whether there was enough credit; what was reserved until then stays reserved.
        """
        for level in Level:
            missing = account.pending[level] + 1 - account.reserved[level]
            if missing > 0:
                if not self._outboxes[level].reserve(missing):
                    return False
                account.reserved[level] += missing
        return True

    def release(self, account: CreditAccount) -> None:
        """Release the credit that was reserved and not used, and forget steps whose transitions never came."""
        for level in Level:
            self._outboxes[level].release(account.reserved[level])
            account.reserved[level] = account.pending[level] = 0

    def offer(self, trajectories: Sequence[Trajectory], account: CreditAccount) -> None:
        """Queue trajectories, which use up the credit reserved for them."""
        for trajectory in trajectories:
            self._outboxes[trajectory.level].offer([trajectory])
            account.reserved[trajectory.level] -= len(trajectory)
            account.pending[trajectory.level] -= len(trajectory)

    def offer_record(self, stream: str, record: dict[str, Any]) -> None:
        """Queue the record of an episode on the stream `EPISODES` or `EVALUATION`."""
        self._outboxes[stream].offer([record])

    def close(self) -> None:
        """Close all outboxes; nothing may be offered afterwards."""
        for outbox in self._outboxes.values():
            outbox.close()

    def flush(self, transport: Transport, now: float) -> None:
        """Publish all frames that are due.

        Raises:
            RunError: a frame cannot be sent or is refused, or a receiver that lives has not acknowledged the oldest
                frame of a stream for too long.
        """
        for stream, outbox in self._outboxes.items():
            if outbox.stuck(now):
                if outbox.refusal:
                    raise RunError(f"{self._actor}: {_CONTENT[stream]} are refused by their receiver: {outbox.refusal}")
                raise RunError(
                    f"{self._actor}: the oldest frame of stream '{stream}' has gone unacknowledged for "
                    f"{self._give_up_after_s:g} s while its receiver lives"
                )
            for frame in outbox.poll(now):
                assert isinstance(frame, Push | Records), "frames are of the kinds that the outboxes were made with"
                if isinstance(frame, Push) and frame.sequence == outbox.acknowledged:
                    frame = replace(frame, first=True)
                transport.publish(self._keys[stream], self._encoded(stream, frame))

    def _encoded(self, stream: str, frame: Push | Records) -> bytes:
        """Return the bytes of a frame; raise RunError where its receiver would refuse them."""
        try:
            return codec.encode(frame)
        except ProtocolError as error:
            raise RunError(f"{self._actor}: {_CONTENT[stream]} cannot be sent: {error.__cause__}") from error

    def wakes(self, now: float) -> list[float]:
        """Return the times at which a frame is due again, one for each outbox that has any."""
        return [wake_s for outbox in self._outboxes.values() if (wake_s := outbox.next_wake(now))]

    def statistics(self) -> dict[str, float]:
        """Return the counts of each outbox, with the stream's name before them."""
        return {
            f"{stream}_{name}": value
            for stream, outbox in self._outboxes.items()
            for name, value in outbox.statistics().items()
        }
