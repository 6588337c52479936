"""Both halves over a channel that drops, repeats, delays and reorders: nothing is lost, duplicated or out of order."""

import numpy as np
import pytest
from faulty import Faults, FaultyTransport

from zsdist.protocol.inbox import Inbox
from zsdist.protocol.outbox import Outbox
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.wire.codec import decode, encode
from zsdist.wire.messages import EPISODES, Ack, Records

SEEDS_A_CASE = 25
STEP_S = 0.01


class Line:
    """One actor's outbox and a receiver's inbox, a bad channel in each direction, and a clock that steps."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        shares = rng.random(4) * (0.4, 0.3, 0.5, 0.5)
        faults = Faults(drop=shares[0], repeat=shares[1], delay=shares[2], reorder=shares[3], delay_s=0.6)
        broker = MemoryBroker()
        self.rng = rng
        self.now = 0.0
        self.actor = FaultyTransport(MemoryTransport(broker, "actor"), seed, faults)
        self.receiver = FaultyTransport(MemoryTransport(broker, "receiver"), seed + 1, faults)
        self.frames, self.acks = Mailbox(2**20), Mailbox(2**20)
        self.receiver.subscribe("push", self.frames)
        self.actor.subscribe("ack", self.acks)
        self.inbox = Inbox(EPISODES, hold_frames=16)
        self.delivered: list[int] = []

    def outbox(self, epoch: int) -> Outbox:
        return Outbox(
            EPISODES, "a0", epoch, window_frames=12, resend_after_s=0.25, give_up_after_s=60, make_frame=Records
        )

    def step(self, outbox: Outbox) -> None:
        self.now += STEP_S
        for frame in outbox.poll(self.now):
            self.actor.publish("push", encode(frame))
        self.actor.tick(self.now)
        for message in self.frames.drain():
            frame = decode(message.payload)
            assert isinstance(frame, Records)
            for delivered in self.inbox.receive(frame, self.now):
                self.delivered += [record["number"] for record in delivered.records]
        for ack in self.inbox.acks(self.now, lambda actor, epoch: None):
            self.receiver.publish("ack", encode(ack))
        self.receiver.tick(self.now)
        for message in self.acks.drain():
            ack = decode(message.payload)
            assert isinstance(ack, Ack)
            outbox.on_ack(ack, self.now)
        assert outbox.statistics()["unacknowledged_frames"] <= 12


@pytest.mark.parametrize("case", range(8))
def test_everything_arrives_once_and_in_order_over_any_bad_channel(case: int) -> None:
    resent = duplicates = 0
    for seed in range(case * SEEDS_A_CASE, (case + 1) * SEEDS_A_CASE):
        line = Line(seed)
        outbox, offered = line.outbox(1), 0
        line.inbox.issue("a0", 1)
        while not outbox.drained:
            assert line.now < 120, f"seed {seed} does not end"
            if offered < 60:
                count = int(line.rng.integers(0, 4))
                outbox.offer([{"number": offered + index} for index in range(count)])
                offered += count
                if offered >= 60:
                    outbox.close()
            line.step(outbox)
        assert line.delivered == list(range(offered)), f"seed {seed}"
        assert line.inbox.closed
        assert line.inbox.produced == outbox.produced == offered
        assert line.inbox.abandoned_at_most == 0
        assert not line.inbox.refused, f"seed {seed}"
        resent += outbox.statistics()["resent_frames"]
        duplicates += line.inbox.duplicates
    assert resent > 5 * SEEDS_A_CASE, "the channels were not bad enough to show anything"
    assert duplicates > 5 * SEEDS_A_CASE


@pytest.mark.parametrize("case", range(4))
def test_the_counts_agree_when_an_actor_dies_and_is_replaced(case: int) -> None:
    for seed in range(case * SEEDS_A_CASE, (case + 1) * SEEDS_A_CASE):
        line = Line(1000 + seed)
        first = line.outbox(1)
        line.inbox.issue("a0", 1)
        first.offer([{"number": number} for number in range(40)])
        for _ in range(int(line.rng.integers(1, 40))):
            line.step(first)
        arrived = len(line.delivered)
        assert line.delivered == list(range(arrived))
        line.inbox.issue("a0", 2)
        assert arrived + line.inbox.abandoned_at_most <= first.produced
        second = line.outbox(2)
        second.offer([{"number": number} for number in range(100, 130)])
        second.close()
        while not second.drained:
            assert line.now < 120, f"seed {seed} does not end"
            line.step(second)
        assert line.delivered == [*range(arrived), *range(100, 130)], f"seed {seed}: old frames in the pipe do no harm"
        assert line.inbox.produced == arrived + 30
