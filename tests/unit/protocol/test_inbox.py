"""Receiving half alone: accepted frames, times of acknowledgements, and counts."""

import json
import random

from operations import operations

from zsdist.protocol.inbox import ACK_AFTER_S, ACK_EVERY_FRAMES, HEARTBEAT_S, Inbox
from zsdist.types import MAX_REASON, Level
from zsdist.wire import codec
from zsdist.wire.messages import EPISODES, Ack, Push, Records


def frame(
    sequence: int, *, epoch: int = 1, actor: str = "a0", closes: bool = False, total: int | None = None
) -> Records:
    """Return a frame with one record, with the right running total unless `total` is given."""
    produced = sequence + 1 if total is None else total
    return Records(EPISODES, actor, epoch, sequence, produced, closes, ({"number": sequence},))


def listening(**issued: int) -> Inbox:
    inbox = Inbox(EPISODES, sender_epoch=7)
    for actor, epoch in (issued or {"a0": 1}).items():
        inbox.issue(actor, epoch)
    return inbox


def sequences(frames: list) -> list[int]:
    return [item.sequence for item in frames]


def unlimited(actor: str, epoch: int) -> int | None:
    return None


def test_frames_come_out_in_order_each_once() -> None:
    inbox = listening()
    assert sequences(inbox.receive(frame(0), 0.0)) == [0]
    assert sequences(inbox.receive(frame(2), 0.0)) == []
    assert sequences(inbox.receive(frame(3), 0.0)) == []
    assert sequences(inbox.receive(frame(2), 0.0)) == []
    assert sequences(inbox.receive(frame(1), 0.0)) == [1, 2, 3]
    assert sequences(inbox.receive(frame(1), 0.0)) == []
    assert inbox.duplicates == 2
    assert inbox.produced == 4
    assert not inbox.refused


def test_only_frames_of_issued_epochs_are_accepted() -> None:
    inbox = listening(a0=5)
    inbox.receive(frame(0, actor="stranger"), 0.0)
    inbox.receive(frame(0, epoch=6), 0.0)
    inbox.receive(frame(0, epoch=4), 0.0)
    inbox.receive(Push(Level.LOW, "a0", 5, 0, 0, True, ()), 0.0)
    assert inbox.refused == {"unknown_epoch": 2, "closed_epoch": 1, "wrong_stream": 1}
    assert inbox.produced == 0


def test_early_frames_that_together_are_too_large_are_refused_and_accepted_when_their_turn_comes() -> None:
    inbox = Inbox(EPISODES, hold_bytes=3 * frame(1).nbytes)
    inbox.issue("a0", 1)
    early = [number for number in range(1, 200) if inbox.receive(frame(number), 0.0)]
    assert early == [] and inbox.refused["no_room"] == 199 - 3
    assert sequences(inbox.receive(frame(0), 0.0)) == [0, 1, 2, 3]
    delivered = [number for turn in range(4, 200) for number in sequences(inbox.receive(frame(turn), 0.0))]
    assert delivered == list(range(4, 200)) and inbox.produced == 200


def test_a_frame_takes_the_bytes_of_its_content() -> None:
    small, large = (Records(EPISODES, "a0", 1, 0, 1, False, ({"path": [0.5] * count},)) for count in (10, 1000))
    assert large.nbytes > 50 * small.nbytes


def test_a_frame_too_far_ahead_is_refused_rather_than_held() -> None:
    inbox = Inbox(EPISODES, hold_frames=4)
    inbox.issue("a0", 1)
    assert inbox.receive(frame(4), 0.0) == []
    assert inbox.refused == {"beyond_window": 1}
    for sequence in (3, 2, 1):
        inbox.receive(frame(sequence), 0.0)
    assert sequences(inbox.receive(frame(0), 0.0)) == [0, 1, 2, 3]


def test_a_frame_with_a_wrong_total_is_refused_and_the_right_one_accepted() -> None:
    inbox = listening()
    inbox.receive(frame(1, total=99), 0.0)
    assert sequences(inbox.receive(frame(0), 0.0)) == [0]
    assert inbox.refused == {"wrong_total": 1}
    assert sequences(inbox.receive(frame(1), 0.0)) == [1]
    assert inbox.produced == 2


def test_acks_come_soon_after_a_receipt_and_at_once_after_several() -> None:
    inbox = listening()
    assert inbox.next_wake(0.0) == 0.0
    assert inbox.acks(0.0, unlimited) == [Ack(7, "a0", 1, EPISODES, 0, None)]
    inbox.receive(frame(0), 0.1)
    assert inbox.acks(0.1, unlimited) == []
    assert inbox.next_wake(0.1) == 0.1 + ACK_AFTER_S
    assert inbox.acks(0.1 + ACK_AFTER_S, unlimited) == [Ack(7, "a0", 1, EPISODES, 1, None)]
    for sequence in range(1, ACK_EVERY_FRAMES + 1):
        inbox.receive(frame(sequence), 0.2)
    assert [ack.received for ack in inbox.acks(0.2, unlimited)] == [ACK_EVERY_FRAMES + 1]


def test_a_heartbeat_with_the_credit_comes_without_any_frame() -> None:
    inbox = Inbox(Level.LOW)
    inbox.issue("a0", 1)
    inbox.issue("a1", 4)
    credit = {("a0", 1): 100, ("a1", 4): 200}
    first = inbox.acks(0.0, lambda actor, epoch: credit[actor, epoch])
    assert [(ack.actor, ack.credit) for ack in first] == [("a0", 100), ("a1", 200)]
    assert inbox.acks(HEARTBEAT_S - 0.001, unlimited) == []
    assert inbox.next_wake(0.1) == HEARTBEAT_S
    assert len(inbox.acks(HEARTBEAT_S, unlimited)) == 2


def test_a_closed_epoch_is_acknowledged_again_when_its_last_frame_comes_again() -> None:
    inbox = listening()
    inbox.receive(frame(0), 0.0)
    inbox.receive(frame(1, closes=True), 0.0)
    assert inbox.closed
    assert [ack.received for ack in inbox.acks(1.0, unlimited)] == [2]
    assert inbox.acks(2.0, unlimited) == []
    assert inbox.next_wake(2.0) is None
    inbox.receive(frame(1, closes=True), 3.0)
    assert [ack.received for ack in inbox.acks(3.0 + ACK_AFTER_S, unlimited)] == [2]
    inbox.receive(frame(2), 4.0)
    assert inbox.refused == {"after_close": 1}


def test_a_newer_epoch_abandons_the_older_at_its_last_frame_in_order() -> None:
    inbox = listening()
    inbox.receive(frame(0), 0.0)
    inbox.receive(frame(2), 0.0)
    inbox.issue("a0", 2)
    inbox.issue("a0", 1)
    assert inbox.open_streams() == [("a0", 2)]
    assert inbox.receive(frame(1), 0.0) == []
    assert inbox.refused == {"closed_epoch": 1}
    assert sequences(inbox.receive(frame(0, epoch=2), 0.0)) == [0]
    assert inbox.produced == 2
    assert inbox.abandoned_at_most == 2, "its frame 2 told that three were produced, one arrived"


def test_a_dead_actor_has_lost_at_most_its_credit_minus_what_arrived() -> None:
    inbox = Inbox(Level.LOW)
    inbox.issue("a0", 1)
    inbox.acks(0.0, lambda actor, epoch: 50)
    inbox.close("a0", 1)
    assert (inbox.abandoned_at_most, inbox.abandoned_unlimited) == (50, 0)
    inbox.issue("a1", 2)
    inbox.acks(0.0, unlimited)
    inbox.close("a1", 2)
    assert (inbox.abandoned_at_most, inbox.abandoned_unlimited) == (50, 1)
    inbox.issue("a2", 3)
    inbox.acks(0.0, unlimited)
    inbox.acks(9.0, lambda actor, epoch: 30)
    inbox.close("a2", 3)
    assert (inbox.abandoned_at_most, inbox.abandoned_unlimited) == (80, 1), "what counts is its credit at the end"
    assert inbox.closed


def test_its_state_survives_json_and_is_resumed() -> None:
    inbox = listening(a0=1, a1=3)
    inbox.receive(frame(0), 0.0)
    inbox.receive(frame(2), 0.0)
    inbox.receive(frame(0, actor="a1", epoch=3, closes=True), 0.0)
    inbox.receive(frame(0, actor="a2"), 0.0)
    restored = Inbox(EPISODES, sender_epoch=8)
    restored.restore(json.loads(json.dumps(inbox.state())))
    assert restored.state() == inbox.state()
    assert restored.open_streams() == [("a0", 1)]
    assert [(ack.actor, ack.received, ack.sender_epoch) for ack in restored.acks(9.0, unlimited)] == [("a0", 1, 8)]
    assert sequences(restored.receive(frame(1), 9.0)) == [1], "frame 2 was not acknowledged, so it comes again"
    assert sequences(restored.receive(frame(2), 9.0)) == [2]
    assert restored.produced == 4


def test_acknowledgements_tell_why_a_frame_was_refused_until_one_is_delivered():
    inbox = Inbox(EPISODES, sender_epoch=7)
    inbox.issue("a0", 1)
    inbox.note_refusal("a0", 1, "content: too long\n" + "x" * 500)
    inbox.note_refusal("a0", 2, "of another epoch")
    inbox.note_refusal("unknown", 1, "of nobody")
    (ack,) = inbox.acks(0.0, unlimited)
    assert ack.refused.startswith("content: too longx") and len(ack.refused) == MAX_REASON
    codec.decode(codec.encode(ack), expect=Ack)
    inbox.receive(Records(EPISODES, "a0", 1, 0, 1, False, ({"episode": 1},)), 1.0)
    (ack,) = inbox.acks(2.0, unlimited)
    assert ack.refused == ""


def test_lost_frames_are_skipped_once_and_the_held_ones_behind_them_follow():
    inbox = listening()
    inbox.receive(frame(0), 0.0)
    inbox.receive(frame(3), 0.0)
    assert inbox.skip("a0", 1, 2, 2) == 1
    assert inbox.progress("a0") == (1, 2, 2, False)
    assert sequences(inbox.receive(frame(2), 0.0)) == [2, 3]
    assert inbox.receive(frame(1), 0.0) == [] and inbox.duplicates == 1
    assert inbox.produced == 4
    assert inbox.skip("a0", 1, 2, 2) is None


def test_only_what_is_missing_of_an_open_epoch_is_skipped():
    inbox = listening(a0=2)
    inbox.receive(frame(0, epoch=2), 0.0)
    nothing = ((0, 0), (1, 1), (3, 0), (2**62 - 1, 5), (5, 2**62 - 1))  # before it, not missing, impossible totals
    assert [inbox.skip("a0", 2, received, produced) for received, produced in nothing] == [None] * len(nothing)
    assert inbox.skip("a0", 1, 5, 5) is None and inbox.skip("a9", 2, 5, 5) is None
    assert inbox.skip("a0", 2, 5, 5, closed=True) == 4 and inbox.closed
    assert inbox.skip("a0", 2, 6, 6) is None


def work_for_a_frame(actors: int) -> int:
    """Return the operations for a frame of one of many actors, from its receipt to its acknowledgement."""
    inbox = listening(**{f"a{index}": 1 for index in range(actors)})
    assert len(inbox.acks(0.0, unlimited)) == actors

    def once() -> None:
        inbox.receive(frame(0), 0.01)
        assert inbox.next_wake(0.01) == 0.01 + ACK_AFTER_S
        assert [ack.actor for ack in inbox.acks(0.01 + ACK_AFTER_S, unlimited)] == ["a0"]
        assert not inbox.closed

    return operations(once)


def test_a_frame_takes_as_much_work_among_many_actors_as_among_few() -> None:
    assert work_for_a_frame(2048) < 1.1 * work_for_a_frame(8)


def test_acknowledgements_are_due_when_a_look_at_every_actor_would_say_so() -> None:
    rng, inbox, now = random.Random(0), Inbox(EPISODES), 0.0
    sent, due = {}, {}  # frames by actor; times at which each is heard of at the latest
    for _ in range(2000):
        now += rng.choice((0.0, 0.005, 0.03))
        actor = f"a{rng.randrange(12)}"
        if actor not in sent or rng.random() < 0.02:
            epoch = sent.get(actor, (0, 0))[0] + 1
            inbox.issue(actor, epoch)
            sent[actor], due[actor] = (epoch, 0), now
        elif rng.random() < 0.6:
            epoch, count = sent[actor]
            assert len(inbox.receive(frame(count, epoch=epoch, actor=actor), now)) == 1
            sent[actor], due[actor] = (epoch, count + 1), min(due[actor], now + ACK_AFTER_S)
        told = {ack.actor: ack for ack in inbox.acks(now, unlimited)}
        assert {actor for actor, at in due.items() if at <= now} <= told.keys()
        for actor, ack in told.items():
            assert (ack.epoch, ack.received) == sent[actor]
            due[actor] = now + HEARTBEAT_S
        wake_s = inbox.next_wake(now)
        assert wake_s is not None and wake_s <= min(due.values())
