"""What only the memory transport promises: order, and work that does not grow with the number of transports."""

import random

import pytest
from operations import operations

from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport, PatternTree, matches


def test_a_tree_finds_the_mailboxes_of_all_patterns_that_match_in_their_order():
    rng, tree, entered = random.Random(0), PatternTree(), {}
    parts = ("a", "b", "c", "*", "**")
    for number in range(3000):
        if entered and rng.random() < 0.4:
            place = rng.choice(sorted(entered))
            tree.remove(entered.pop(place)[0], place)
        else:
            pattern = "/".join(rng.choice(parts) for _ in range(rng.randint(1, 4)))
            place = (rng.randrange(8), number)
            entered[place] = pattern, Mailbox(100)
            tree.add(pattern, place, entered[place][1])
        key = "/".join(rng.choice(parts[:3]) for _ in range(rng.randint(1, 4)))
        assert tree.find(key) == [box for _, (pattern, box) in sorted(entered.items()) if matches(pattern, key)]
    for place, (pattern, _) in entered.items():
        tree.remove(pattern, place)
    assert vars(tree) == vars(PatternTree())


@pytest.mark.parametrize("act", ["publish", "request", "token"])
def test_a_message_takes_as_much_work_among_many_transports_as_among_few(act):
    def work(count):
        broker = MemoryBroker()
        transports = [MemoryTransport(broker, str(number)) for number in range(count)]
        for number, transport in enumerate(transports):
            for enter in (transport.subscribe, transport.serve, transport.watch_alive):
                enter(f"run/*/{number}", Mailbox(1000))
        acts = {
            "publish": lambda: transports[1].publish("run/a/0", b"", retained=True),
            "request": lambda: transports[1].request("run/a/0", b"", Mailbox(100), timeout_s=1.0),
            "token": lambda: transports[1].declare_alive("run/a/0"),
        }
        return operations(acts[act])

    assert work(1024) < 1.1 * work(8)


def test_a_transport_that_closes_leaves_nothing_at_the_broker():
    broker, box = MemoryBroker(), Mailbox(1000)
    gone, stays = MemoryTransport(broker, "gone"), MemoryTransport(broker, "stays")
    gone.subscribe("a", box)
    gone.serve("a", box)
    gone.watch_alive("a", box)
    gone.publish("b", b"kept", retained=True)
    box.drain()
    gone.close()
    stays.publish("a", b"x")
    stays.request("a", b"?", Mailbox(100), timeout_s=1.0)
    stays.declare_alive("a")
    late = Mailbox(1000)
    stays.subscribe("b", late, retained=True)
    assert not box.drain() and not late.drain() and not broker.kept
