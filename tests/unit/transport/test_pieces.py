import random
import threading

import pytest

from zsdist.transport.pieces import (
    GONE_AFTER_S,
    KEPT,
    KEPT_S,
    PIECE_BYTES,
    STALLED_AFTER_S,
    WINDOW,
    Assembly,
    Fetcher,
    Manifest,
    PieceStore,
)

PAYLOAD = random.Random(0).randbytes(20 * PIECE_BYTES + 123)
PATIENCE_S = 10.0


class Clock:
    """Clock that a test sets."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def piece(index, payload=PAYLOAD):
    return payload[index * PIECE_BYTES : (index + 1) * PIECE_BYTES]


def questions(payload=PAYLOAD):
    """Return the questions of a receiver that gets every answer, in order, the last one among them."""
    asked, done = [], threading.Event()
    store = PieceStore(release=False)
    manifest = store.keep("key", payload)

    def ask(key, question, answered):
        asked.append(question)
        answer = store.answer(key, question)
        if answer is not None:
            answered(answer)

    fetcher = Fetcher(ask, len(payload))
    fetcher.fetch("key", 1, manifest, lambda _: done.set() or True)
    assert done.wait(PATIENCE_S)
    fetcher.close()
    return asked


def test_a_manifest_survives_the_way_and_nothing_else_is_one():
    manifest = Manifest.of(PAYLOAD)
    assert Manifest.unpack(manifest.pack()) == manifest and manifest.pieces == 21
    assert Manifest.unpack(b"") is None and Manifest.unpack(manifest.pack() + b"x") is None


@pytest.mark.parametrize("seed", range(20))
def test_a_payload_arrives_whatever_is_lost_late_doubled_or_out_of_order(seed):
    chance, now = random.Random(seed), 0.0
    assembly = Assembly(Manifest.of(PAYLOAD), now)
    on_their_way = []
    for _ in range(10_000):
        if assembly.complete:
            break
        for index in assembly.due(now):
            on_their_way += [index] * chance.choice((0, 1, 1, 1, 1, 2))
        chance.shuffle(on_their_way)
        if on_their_way and chance.random() < 0.7:
            index = on_their_way.pop()
            assembly.add(index, piece(index), now)
        else:
            now = min(now + 1.0, assembly.next_wake_s)
    assert assembly.payload() == PAYLOAD and not assembly.stalled(now)


def test_few_pieces_are_on_their_way_and_fewer_after_a_loss():
    assembly = Assembly(Manifest.of(PAYLOAD), 0.0)
    assert assembly.due(0.0) == list(range(WINDOW)) and assembly.due(0.0) == []
    assembly.add(0, piece(0), 0.1)
    assert assembly.due(0.1) == [WINDOW]
    lost_s = assembly.next_wake_s
    assert len(assembly.due(lost_s)) < WINDOW / 2 + 1


def test_a_payload_without_progress_is_given_up_and_sooner_where_the_sender_has_lost_it():
    assembly = Assembly(Manifest.of(PAYLOAD), 0.0)
    assembly.add(3, piece(3), 5.0)
    assert not assembly.stalled(5.0 + STALLED_AFTER_S - 0.1) and assembly.stalled(5.0 + STALLED_AFTER_S)
    assembly.add(4, b"", 6.0)
    assert not assembly.stalled(6.0) and assembly.stalled(6.0 + GONE_AFTER_S)


@pytest.mark.parametrize("wrong", [b"x", piece(20), piece(1) + b"x"])
def test_a_piece_of_a_wrong_size_is_ignored(wrong):
    assembly = Assembly(Manifest.of(PAYLOAD), 0.0)
    assembly.add(1, wrong, 0.0)
    for index in range(21):
        assembly.add(index, piece(index), 0.0)
    assert assembly.payload() == PAYLOAD


def test_a_payload_that_is_not_the_announced_one_is_not_delivered():
    assembly = Assembly(Manifest.of(PAYLOAD), 0.0)
    for index in range(21):
        assembly.add(index, piece(index) if index != 7 else bytes(PIECE_BYTES), 0.0)
    assert assembly.complete and assembly.payload() is None


def test_a_sender_keeps_its_newest_payload_and_those_that_are_being_fetched():
    clock = Clock()
    store = PieceStore(release=False, clock=clock)
    asked = questions()[0]
    first = store.keep("key", PAYLOAD)
    assert first == Manifest.of(PAYLOAD) and store.answer("key", asked) == piece(0)
    for number in range(KEPT - 1):
        assert store.keep("key", b"%d" % number) is not None
    assert store.keep("key", b"one too many") is None
    clock.now = KEPT_S - 1.0
    assert store.answer("key", asked) == piece(0)
    clock.now = KEPT_S
    assert store.keep("key", b"later") is not None
    assert store.answer("key", asked) == piece(0), "it was asked for a moment ago"
    clock.now = 3 * KEPT_S
    assert store.keep("key", b"much later") is not None
    assert store.answer("key", asked) == b""
    assert store.answer("other", asked) == b"" and store.answer("key", b"nonsense") is None


def test_a_reply_is_forgotten_once_its_receiver_has_everything_and_a_value_is_not():
    *pieces, everything = questions()
    for release in (True, False):
        store = PieceStore(release=release)
        store.keep("key", PAYLOAD)
        assert [store.answer("key", question) for question in pieces] == [piece(index) for index in range(21)]
        assert store.answer("key", everything) is None
        assert store.answer("key", pieces[0]) == (b"" if release else piece(0))


class Link:
    """Sender whose answers a test lets through, and the payloads that arrived."""

    def __init__(self, most_bytes=2**30):
        self.store, self.held, self.arrived = PieceStore(release=False), [], []
        self.changed = threading.Condition()
        self.open = True
        self.room = True
        self.fetcher = Fetcher(self.ask, most_bytes)

    def ask(self, key, question, answered):
        answer = self.store.answer(key, question)
        if answer is None:
            return
        with self.changed:
            self.held.append((answered, answer))
            self.changed.notify_all()
        if self.open:
            self.let_through()

    def let_through(self):
        with self.changed:
            held, self.held = self.held, []
        for answered, answer in held:
            answered(answer)

    def announce(self, payload, **options):
        self.fetcher.fetch("key", 1, self.store.keep("key", payload), self.deliver, **options)

    def deliver(self, payload):
        with self.changed:
            if self.room:
                self.arrived.append(payload)
            self.changed.notify_all()
            return self.room

    def wait(self, condition):
        with self.changed:
            assert self.changed.wait_for(condition, PATIENCE_S)


@pytest.fixture
def link():
    made = Link()
    yield made
    made.fetcher.close()


def test_a_value_is_finished_before_the_newest_of_those_announced_meanwhile_follows(link):
    link.open = False
    link.announce(PAYLOAD)
    link.wait(lambda: link.held)
    for number in range(3):
        link.announce(PAYLOAD + b"%d" % number)
    link.open = True
    link.let_through()
    link.wait(lambda: len(link.arrived) == 2)
    assert link.arrived == [PAYLOAD, PAYLOAD + b"2"]
    assert not link.fetcher.fetching("key", 1)


def test_a_value_that_has_been_delivered_is_fetched_again_only_as_a_reply(link):
    for is_reply in (False, False, True):
        link.announce(PAYLOAD, is_reply=is_reply)
        link.wait(lambda: not link.fetcher.fetching("key", 1) or True)
        link.wait(lambda: link.arrived)
    link.wait(lambda: len(link.arrived) == 2)


def test_a_receiver_may_ask_for_the_next_reply_while_it_gets_one(link):
    asked = []

    def deliver(payload):
        if not asked:
            asked.append(link.fetcher.fetching("key", 1))
            link.announce(PAYLOAD)
        return Link.deliver(link, payload)

    link.deliver = deliver
    link.announce(PAYLOAD)
    link.wait(lambda: len(link.arrived) == 2)
    assert asked == [False]


def test_a_payload_waits_for_room(link):
    link.room = False
    link.announce(PAYLOAD)
    link.wait(lambda: link.fetcher.fetching("key", 1))
    with link.changed:
        link.room = True
    link.wait(lambda: link.arrived)


def test_a_payload_beyond_the_limit_is_not_fetched():
    link = Link(most_bytes=len(PAYLOAD) - 1)
    link.announce(PAYLOAD)
    assert not link.fetcher.fetching("key", 1) and not link.held
