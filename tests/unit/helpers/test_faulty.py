"""Faults occur as configured and follow from the seed and the time that `tick` sets."""

from faulty import Faults, FaultyTransport

from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport


def sent_through(faults: Faults, seed: int = 0, count: int = 400) -> list[int]:
    """Return the numbers that arrive of 0 to `count`, one sent each millisecond."""
    broker = MemoryBroker()
    box = Mailbox(2**20)
    receiver = MemoryTransport(broker, "receiver")  # one that is dropped is closed
    receiver.subscribe("k", box)
    sender = FaultyTransport(MemoryTransport(broker, "sender"), seed, faults)
    for number in range(count):
        sender.publish("k", b"%d" % number)
        sender.tick(number / 1000)
    sender.tick(1e9)
    return [int(message.payload) for message in box.drain()]


def test_without_faults_nothing_changes() -> None:
    assert sent_through(Faults()) == list(range(400))


def test_dropped_messages_never_arrive() -> None:
    arrived = sent_through(Faults(drop=0.3))
    assert 200 < len(arrived) < 350
    assert arrived == sorted(set(arrived))


def test_repeated_messages_arrive_twice() -> None:
    arrived = sent_through(Faults(repeat=0.3))
    assert set(arrived) == set(range(400))
    assert 450 < len(arrived) < 600


def test_delayed_messages_arrive_late_but_within_the_limit() -> None:
    arrived = sent_through(Faults(delay=0.5, delay_s=0.02))
    assert sorted(arrived) == list(range(400))
    assert arrived != sorted(arrived)
    assert max(abs(place - number) for place, number in enumerate(arrived)) <= 25


def test_reordered_messages_are_swapped_with_the_next() -> None:
    broker, box = MemoryBroker(), Mailbox(2**20)
    receiver = MemoryTransport(broker, "receiver")  # one that is dropped is closed
    receiver.subscribe("k", box)
    sender = FaultyTransport(MemoryTransport(broker, "sender"), 0, Faults(reorder=1.0))
    for number in range(4):
        sender.publish("k", b"%d" % number)
    assert [message.payload for message in box.drain()] == [b"1", b"0", b"3", b"2"]


def test_equal_seeds_give_equal_faults_and_others_do_not() -> None:
    faults = Faults(drop=0.2, repeat=0.2, delay=0.2, reorder=0.2)
    assert sent_through(faults, 1) == sent_through(faults, 1)
    assert sent_through(faults, 1) != sent_through(faults, 2)


def test_a_dropped_request_never_arrives() -> None:
    broker, asked = MemoryBroker(), Mailbox(2**20)
    server = MemoryTransport(broker, "server")
    server.serve("q", asked)
    asker = FaultyTransport(MemoryTransport(broker, "asker"), 0, Faults(drop=1.0))
    asker.request("q", b"?", Mailbox(100), timeout_s=1.0)
    assert not len(asked)
    asker.faults = Faults()
    asker.request("q", b"?", Mailbox(100), timeout_s=1.0)
    assert len(asked) == 1
