"""Sending half alone: times of frames, and the effect of credit."""

import numpy as np
import pytest

from zsdist.errors import ProtocolError
from zsdist.protocol.outbox import BACKOFF_MAX, LINGER_S, MAX_COUNT, RESEND_BURST, Outbox
from zsdist.types import Level, Trajectory
from zsdist.wire.messages import EPISODES, Ack, Push, Records

RESEND_S = 0.25
GIVE_UP_S = 60.0


def trajectory(transitions: int) -> Trajectory:
    return Trajectory(
        level=Level.LOW,
        states=np.zeros((transitions + 1, 2), np.float32),
        actions=np.zeros(transitions, np.uint8),
        rewards=np.zeros(transitions, np.float32),
        discounts=np.ones(transitions, np.float32),
        successors=np.arange(1, transitions + 1, dtype=np.uint16),
        masks=np.ones((transitions + 1, 5), np.bool_),
        guides=np.zeros(transitions, np.int8),
        behaviours=np.zeros(transitions, np.uint8),
        weight_version=0,
    )


def pushes(window_frames: int = 4, credit: int | None = None) -> Outbox:
    outbox = Outbox(
        Level.LOW,
        "a0",
        3,
        window_frames=window_frames,
        resend_after_s=RESEND_S,
        give_up_after_s=GIVE_UP_S,
        make_frame=Push,
    )
    outbox.on_ack(ack(0, credit), 0.0)
    return outbox


def ack(received: int, credit: int | None = None, *, sender_epoch: int = 1, epoch: int = 3, actor: str = "a0") -> Ack:
    return Ack(sender_epoch, actor, epoch, "low", received, credit)


def give(outbox: Outbox, *sizes: int) -> None:
    assert outbox.reserve(sum(sizes))
    outbox.offer([trajectory(size) for size in sizes])


def test_small_trajectories_travel_together_and_wait_for_others_for_a_limited_time() -> None:
    outbox = pushes()
    give(outbox, 5, 5)
    assert outbox.poll(1.0) == []
    assert outbox.next_wake(1.0) == 1.0 + LINGER_S
    give(outbox, 6)
    (frame,) = outbox.poll(1.01)
    assert isinstance(frame, Push)
    assert (frame.sequence, frame.produced, frame.count, frame.closes) == (0, 16, 16, False)
    outbox.on_ack(ack(1), 1.5)
    give(outbox, 3)
    assert outbox.poll(2.0) == []
    (frame,) = outbox.poll(2.0 + LINGER_S)
    assert (frame.sequence, frame.produced, frame.count) == (1, 19, 3)


def test_records_travel_at_once_and_need_no_credit() -> None:
    outbox = Outbox(
        EPISODES, "a0", 0, window_frames=4, resend_after_s=RESEND_S, give_up_after_s=GIVE_UP_S, make_frame=Records
    )
    outbox.offer([{"number": 1}, {"number": 2}])
    (frame,) = outbox.poll(0.0)
    assert frame == Records(EPISODES, "a0", 0, 0, 2, False, ({"number": 1}, {"number": 2}))


def test_frames_stay_below_a_size_and_within_the_window() -> None:
    outbox = pushes(window_frames=2)
    give(outbox, *[100] * 8)
    first = outbox.poll(0.0)
    assert [frame.count for frame in first] == [200, 200]
    assert all(frame.count <= MAX_COUNT for frame in first)
    assert outbox.poll(0.0) == []
    assert outbox.produced == 400
    outbox.on_ack(ack(1), 0.1)
    assert [frame.sequence for frame in outbox.poll(0.1)] == [2]


def test_an_unacknowledged_frame_is_sent_again_at_growing_intervals() -> None:
    outbox = pushes()
    give(outbox, 16)
    (frame,) = outbox.poll(0.0)
    times, now = [], 0.0
    while now < 5.0:
        wake = outbox.next_wake(now)
        assert wake is not None
        assert wake > now
        assert outbox.poll(wake - 1e-6) == []
        now = wake
        assert outbox.poll(now) == [frame]
        times.append(now)
    gaps = np.diff([0.0, *times]) / RESEND_S
    assert list(gaps[:3]) == [1, 2, 4]
    assert max(gaps) <= BACKOFF_MAX
    outbox.on_ack(ack(1), now)
    assert outbox.next_wake(now) is None


def test_a_stalled_receiver_is_not_flooded() -> None:
    outbox = pushes(window_frames=64)
    give(outbox, *[200] * 64)
    assert len(outbox.poll(0.0)) == 64
    now, sent = 0.0, 0
    while now < 10.0:
        now = outbox.next_wake(now) or 10.0
        burst = outbox.poll(now)
        assert len(burst) <= RESEND_BURST
        sent += len(burst)
    assert sent <= 64 * 14


def test_a_new_receiver_gets_at_once_what_its_predecessor_did_not_acknowledge() -> None:
    outbox = pushes()
    give(outbox, 200, 200)
    first, second = outbox.poll(0.0)
    assert outbox.poll(RESEND_S) == [first, second]  # the next time it would be sent is two waits later
    outbox.on_ack(ack(1, sender_epoch=2), 1.1 * RESEND_S)
    assert outbox.poll(1.4 * RESEND_S) == [second]
    outbox.on_ack(ack(1, sender_epoch=2), 1.5 * RESEND_S)
    assert outbox.poll(2.0 * RESEND_S) == []


def test_acks_for_others_from_the_past_or_of_frames_never_sent_are_ignored() -> None:
    outbox = pushes()
    give(outbox, 16)
    outbox.poll(0.0)
    outbox.on_ack(ack(0, sender_epoch=5), 0.0)
    for stranger in (ack(1, epoch=2), ack(1, actor="a1"), ack(1, sender_epoch=4), ack(2, sender_epoch=5)):
        outbox.on_ack(stranger, 0.1)
    assert outbox.statistics()["unacknowledged_frames"] == 1
    assert outbox.statistics()["ignored_acks"] == 2
    outbox.on_ack(ack(1, sender_epoch=6), 0.1)
    assert outbox.statistics()["unacknowledged_frames"] == 0


def test_nothing_can_be_reserved_before_the_receiver_has_answered() -> None:
    outbox = Outbox(
        Level.LOW, "a0", 3, window_frames=4, resend_after_s=RESEND_S, give_up_after_s=GIVE_UP_S, make_frame=Push
    )
    assert not outbox.reserve(1)
    outbox.on_ack(ack(0, 10), 0.0)
    assert outbox.reserve(10)
    assert not outbox.reserve(1)


def test_credit_is_an_absolute_total_and_unneeded_credit_is_returned() -> None:
    outbox = pushes(credit=30)
    assert outbox.reserve(24)
    assert not outbox.reserve(7)
    outbox.offer([trajectory(20)])
    outbox.release(4)
    assert outbox.reserve(10)
    assert not outbox.reserve(1)
    outbox.on_ack(ack(0, 31), 0.0)
    assert outbox.reserve(1)
    with pytest.raises(ProtocolError, match="12 transitions released; reserved are 11"):
        outbox.release(12)
    with pytest.raises(ProtocolError, match="12 transitions offered; reserved are 11"):
        outbox.offer([trajectory(12)])


def test_acks_that_overtake_each_other_leave_the_highest_credit() -> None:
    outbox = pushes(credit=None)
    outbox.on_ack(ack(0, 40), 0.0)
    outbox.on_ack(ack(0, None), 0.0)
    assert outbox.credit == 40
    outbox.on_ack(ack(0, 60), 0.0)
    outbox.on_ack(ack(0, 50), 0.0)
    assert outbox.credit == 60
    outbox.on_ack(ack(0, 50, sender_epoch=2), 0.0)
    assert outbox.credit == 50


def test_closing_sends_everything_and_marks_the_last_frame() -> None:
    outbox = pushes(window_frames=2)
    give(outbox, *[200] * 3, 1)
    outbox.close()
    assert [(frame.count, frame.closes) for frame in outbox.poll(0.0)] == [(200, False), (200, False)]
    outbox.on_ack(ack(2), 0.0)
    assert [(frame.count, frame.closes) for frame in outbox.poll(0.0)] == [(201, True)]
    assert not outbox.drained
    outbox.on_ack(ack(3), 0.0)
    assert outbox.drained
    assert outbox.poll(1.0) == []
    with pytest.raises(ProtocolError, match="closed"):
        outbox.offer([])


def test_closing_with_nothing_left_sends_an_empty_frame() -> None:
    outbox = pushes()
    outbox.close()
    assert outbox.next_wake(0.0) == 0.0
    (frame,) = outbox.poll(0.0)
    assert (frame.count, frame.closes, frame.sequence) == (0, True, 0)


def test_an_outbox_is_stuck_only_if_a_live_receiver_never_acknowledges_the_oldest_frame() -> None:
    outbox = pushes()
    give(outbox, 16)
    outbox.poll(0.0)
    assert not outbox.stuck(GIVE_UP_S * 2), "a receiver that is away may come back"
    for second in range(200, 200 + int(GIVE_UP_S) + 1):
        outbox.on_ack(ack(0), float(second))
        assert not outbox.stuck(float(second))
    outbox.on_ack(ack(0), 262.0)
    assert outbox.stuck(262.0)
    outbox.on_ack(ack(1), 262.1)
    assert not outbox.stuck(262.1)
