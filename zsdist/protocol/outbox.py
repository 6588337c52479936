"""Sending half of the push protocol: numbers, window, resending and credit. It uses no socket and no clock.

A frame is kept, and sent again after a time, until it is acknowledged, so that nothing is lost whatever the transport
does. The receiver recognises duplicates by the frames' numbers. Credit limits production: it is reserved before a step
or an option begins, so that everything that is produced may be sent.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from zsdist.errors import ProtocolError
from zsdist.protocol.frames import Frame
from zsdist.types import Ack, Level, Trajectory

Item = Trajectory | dict[str, Any]

COMBINE = 16  # transitions from which a frame is sent at once
MAX_COUNT = 256  # most transitions in a frame, unless its first item alone has more
MAX_RECORDS = 16  # most records in a frame; one is large where its episode was long
REFUSED_S = 10.0  # time for which a refused frame is sent again; a damaged one would have been accepted by then
LINGER_S = 0.05  # longest time that fewer than `COMBINE` transitions wait for more
RESEND_BURST = 8  # most frames that one poll sends again
BURST_PAUSE = 0.25  # shortest time between two such polls, in units of `resend_after_s`, to spare the receiver
BACKOFF_MAX = 4.0  # longest time until a frame is sent again, in units of `resend_after_s`
SILENCE_S = 2.0  # silence after which a receiver counts as away; its heartbeat comes every 0.25 s


@dataclass
class _Flight:
    """Numbered frame that is not acknowledged yet."""

    frame: Frame
    sent_s: float
    sendings: int


class Outbox:
    """Sender of the frames of one (stream, actor, epoch) to one receiver.

    Attributes:
        stream: a `Level` for trajectories, or the name of a stream of records.
        actor: name of the actor.
        epoch: incarnation of the actor.
        produced: running total of transitions (or records) in numbered frames.
        credit: absolute total that the stream may produce; None: unlimited. It is 0 until the receiver has answered,
            and None for records. Within an incarnation of the receiver, credit only becomes limited or grows, so
            acknowledgements may overtake each other.
        refusal: why the receiver refused a frame since it last accepted one; empty: it refused none.
    """

    def __init__(
        self,
        stream: Level | str,
        actor: str,
        epoch: int,
        *,
        window_frames: int,
        resend_after_s: float,
        give_up_after_s: float,
        make_frame: Callable[..., Frame],
    ) -> None:
        """Begin an epoch.

        Args:
            stream: a `Level` for trajectories, or the name of a stream of records.
            actor: name of the actor.
            epoch: incarnation of the actor, never used before.
            window_frames: most frames that may be unacknowledged at once.
            resend_after_s: age at which an unacknowledged frame is sent again; doubles with each sending, up to
                `BACKOFF_MAX` times this.
            give_up_after_s: longest time without progress at a receiver that is alive.
            make_frame: function that makes a frame's message, such as `Push`, from stream, actor, epoch, sequence,
                produced, closes and the tuple of items.
        """
        self.stream = stream
        self.actor = actor
        self.epoch = epoch
        self.produced = 0
        self._metered = isinstance(stream, Level)
        self.credit: int | None = 0 if self._metered else None
        self._window_frames = window_frames
        self._resend_after_s = resend_after_s
        self._give_up_after_s = give_up_after_s
        self._make_frame = make_frame
        self._combine, self._most = (COMBINE, MAX_COUNT) if self._metered else (1, MAX_RECORDS)
        self.refusal = ""
        self._waiting: deque[Item] = deque()
        self._waiting_count = 0
        self._waiting_since_s: float | None = None
        self._flight: deque[_Flight] = deque()
        self._sequence = 0  # number of the next frame
        self._claimed = 0  # credit that is reserved, waiting or produced
        self._closing = False
        self._closed = False  # true once the closing frame is numbered
        self._sender_epoch = -1
        self._heard_s: float | None = None
        self._stalled_since_s = 0.0
        self._resend_from_s = 0.0
        self._resent = 0
        self._ignored_acks = 0

    @property
    def acknowledged(self) -> int:
        """Number of frames that are acknowledged, which is the sequence number of the first that is not."""
        return self._sequence - len(self._flight)

    @property
    def waiting(self) -> int:
        """Number of transitions (or records) that are offered but not yet in a numbered frame."""
        return self._waiting_count

    @property
    def drained(self) -> bool:
        """True if the epoch is closed and everything is acknowledged."""
        return self._closed and not self._flight

    def reserve(self, count: int) -> bool:
        """Reserve credit for `count` transitions before they are produced; return false if there is too little."""
        if self.credit is not None and self._claimed + count > self.credit:
            return False
        self._claimed += count
        return True

    def release(self, count: int) -> None:
        """Return reserved credit that is not needed.

        Raises:
            ProtocolError: less is reserved.
        """
        if not 0 <= count <= self._claimed - self._waiting_count - self.produced:
            reserved = self._claimed - self._waiting_count - self.produced
            raise ProtocolError(f"{self._name()}: {count} transitions released; reserved are {reserved}")
        self._claimed -= count

    def offer(self, items: Sequence[Item]) -> None:
        """Queue trajectories or records, to be sent in this order.

        Raises:
            ProtocolError: the outbox is closed, or more is offered than is reserved.
        """
        if self._closing:
            raise ProtocolError(f"{self._name()} is closed; nothing more can be offered")
        count = sum(map(_count, items))
        if not self._metered:
            self._claimed += count
        elif self.produced + self._waiting_count + count > self._claimed:
            free = self._claimed - self.produced - self._waiting_count
            raise ProtocolError(f"{self._name()}: {count} transitions offered; reserved are {free}")
        self._waiting.extend(items)
        self._waiting_count += count

    def close(self) -> None:
        """Send everything without waiting for more, and end the epoch with a closing frame."""
        self._closing = True

    def poll(self, now: float) -> list[Frame]:
        """Return the frames to send now: overdue ones again, then new ones as far as the window allows."""
        frames = self._overdue(now)
        if self._waiting and self._waiting_since_s is None:
            self._waiting_since_s = now
        while len(self._flight) < self._window_frames and self._ripe(now):
            frames.append(self._number(now))
        return frames

    def on_ack(self, ack: Ack, now: float) -> None:
        """Accept an acknowledgement; one for another outbox or from a replaced receiver is ignored."""
        if (ack.stream, ack.actor, ack.epoch) != (self.stream, self.actor, self.epoch):
            return
        acknowledged = self.acknowledged
        if ack.sender_epoch < self._sender_epoch or ack.received > self._sequence:
            self._ignored_acks += 1
            return
        replaced = ack.sender_epoch > self._sender_epoch
        if replaced or self._heard_s is None or now - self._heard_s > SILENCE_S:
            self._stalled_since_s = now  # the time during which the receiver was away does not count
            for flight in self._flight:
                flight.sendings = min(flight.sendings, 1)
                if replaced:  # the new receiver lacks all frames that its predecessor did not acknowledge
                    flight.sent_s = min(flight.sent_s, now - self._resend_after_s)
        if ack.received > acknowledged:
            for _ in range(ack.received - acknowledged):
                self._flight.popleft()
            self._stalled_since_s = now
        if self._metered:
            if replaced or self.credit is None:
                self.credit = ack.credit
            elif ack.credit is not None:
                self.credit = max(self.credit, ack.credit)
        self._sender_epoch = ack.sender_epoch
        self._heard_s = now
        self.refusal = ack.refused

    def next_wake(self, now: float) -> float | None:
        """Return the time at which `poll` has to be called if nothing else happens; None: never."""
        times = [max(flight.sent_s + self._patience_s(flight), self._resend_from_s) for flight in self._flight]
        if len(self._flight) < self._window_frames:
            if self._ripe(now) or (self._waiting and self._waiting_since_s is None):
                return now
            if self._waiting_since_s is not None:
                times.append(self._waiting_since_s + LINGER_S)
        return max(now, min(times)) if times else None

    def stuck(self, now: float) -> bool:
        """Return whether a live receiver has made no progress for too long, so that the run must end."""
        if not self._flight or self._heard_s is None or now - self._heard_s > SILENCE_S:
            return False
        patience_s = min(REFUSED_S, self._give_up_after_s) if self.refusal else self._give_up_after_s
        return now - self._stalled_since_s > patience_s

    def statistics(self) -> dict[str, int]:
        """Return counts of transitions (or records), of frames, and of ignored acknowledgements, by name."""
        return {
            "produced": self.produced,
            "waiting": self._waiting_count,
            "reserved": self._claimed - self._waiting_count - self.produced,
            "sent_frames": self._sequence,
            "unacknowledged_frames": len(self._flight),
            "resent_frames": self._resent,
            "ignored_acks": self._ignored_acks,
        }

    def _overdue(self, now: float) -> list[Frame]:
        """Return the frames to send again."""
        frames: list[Frame] = []
        if now < self._resend_from_s:
            return frames
        for flight in self._flight:
            if now - flight.sent_s >= self._patience_s(flight):
                flight.sent_s = now
                flight.sendings += 1
                frames.append(flight.frame)
                if len(frames) == RESEND_BURST:
                    break
        if frames:
            self._resent += len(frames)
            self._resend_from_s = now + BURST_PAUSE * self._resend_after_s
        return frames

    def _patience_s(self, flight: _Flight) -> float:
        """Return the time after which a frame is sent again."""
        return self._resend_after_s * min(2.0 ** (flight.sendings - 1), BACKOFF_MAX)

    def _ripe(self, now: float) -> bool:
        """Return whether a frame should be made of the waiting items now."""
        if self._closed:
            return False
        if self._closing or self._waiting_count >= self._combine:
            return True
        return self._waiting_since_s is not None and now >= self._waiting_since_s + LINGER_S

    def _number(self, now: float) -> Frame:
        """Return the next numbered frame, made of waiting items."""
        items: list[Item] = []
        count = 0
        while self._waiting and (not items or count + _count(self._waiting[0]) <= self._most):
            item = self._waiting.popleft()
            items.append(item)
            count += _count(item)
        self._waiting_count -= count
        self.produced += count
        self._closed = self._closing and not self._waiting
        frame = self._make_frame(
            self.stream, self.actor, self.epoch, self._sequence, self.produced, self._closed, tuple(items)
        )
        if not self._flight:
            self._stalled_since_s = now
        self._waiting_since_s = now if self._waiting else None
        self._sequence += 1
        self._flight.append(_Flight(frame, now, 1))
        return frame

    def _name(self) -> str:
        return f"outbox {self.stream} of actor {self.actor}, epoch {self.epoch}"


def _count(item: Item) -> int:
    return len(item) if isinstance(item, Trajectory) else 1
