import json
import random
from fractions import Fraction

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from operations import operations

from zsdist.errors import ConfigError, ProtocolError
from zsdist.replay.limiter import Limiter


class Flow(RuleBasedStateMachine):
    """Actors that use their credit in any order, and a learner that takes all batches that it may."""

    @initialize(
        ratio=st.sampled_from([0.1, 0.3, 0.5, 1.0, 1.7, 4.0]),
        min_size=st.integers(1, 40),
        grain=st.integers(1, 24),
        band=st.integers(0, 60),
    )
    def start(self, ratio, min_size, grain, band):
        self.ratio, self.grain, self.band, self.min_size = Fraction(str(ratio)), grain, band, min_size
        self.limiter = Limiter(ratio, min_size, grain, band)
        self.produced, self.opened, self.most_open, self.last_credit = {}, 0, 0, {}
        self.start_excess = 0

    @precondition(lambda self: len(self.produced) < 5)
    @rule()
    def open(self):
        name = f"actor/{self.opened}"
        self.opened += 1
        self.limiter.open(name)
        self.produced[name] = 0
        self.most_open = max(self.most_open, len(self.produced))

    @precondition(lambda self: self.produced)
    @rule(data=st.data())
    def close(self, data):
        name = data.draw(st.sampled_from(sorted(self.produced)))
        credit = self.limiter.credit(name)
        back = self.limiter.close(name)
        assert back == (0 if credit is None else max(0, credit - self.produced[name]))
        del self.produced[name]
        self.last_credit.pop(name, None)

    @precondition(lambda self: self.produced)
    @rule(data=st.data(), amount=st.integers(1, 24))
    def insert(self, data, amount):
        name = data.draw(st.sampled_from(sorted(self.produced)))
        was_limited, credit = self.limiter.limited, self.limiter.credit(name)
        amount = amount if credit is None else min(amount, credit - self.produced[name])
        if amount <= 0:
            return
        rejected = data.draw(st.integers(0, amount))
        self.limiter.count_inserts(name, amount - rejected, rejected)
        self.produced[name] += amount
        if self.limiter.limited and not was_limited:
            self.start_excess = self.limiter.stored

    @precondition(lambda self: self.limiter.allowed)
    @rule(times=st.integers(1, 12))
    def learn(self, times):
        for _ in range(times):
            if self.limiter.allowed:
                self.limiter.take_batch()

    @invariant()
    def credit_is_absolute_and_never_falls(self):
        if not hasattr(self, "limiter"):
            return
        for name in self.produced:
            credit = self.limiter.credit(name)
            assert (credit is None) == (self.limiter.stored < self.min_size)
            if credit is not None:
                assert credit >= self.last_credit.get(name, 0)
                self.last_credit[name] = credit

    @invariant()
    def one_side_can_always_go_on(self):
        if not hasattr(self, "limiter") or not self.limiter.limited or self.limiter.allowed:
            return
        for name, produced in self.produced.items():
            assert self.limiter.credit(name) - produced >= self.grain

    @invariant()
    def the_ratio_is_held_within_the_band(self):
        if not hasattr(self, "limiter") or not self.limiter.limited:
            return
        out = sum(max(0, self.limiter.credit(name) - produced) for name, produced in self.produced.items())
        slack = self.band + self.grain * self.most_open
        assert self.limiter.updates <= self.ratio * self.limiter.stored
        assert self.limiter.stored + out <= max(
            (self.limiter.updates + 1) / self.ratio + slack, self.start_excess + slack
        )


Flow.TestCase.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
TestFlow = Flow.TestCase


def opened(limiter, *names):
    for name in names:
        limiter.open(name)
    return limiter


def test_nothing_is_limited_and_nothing_learned_before_min_size():
    limiter = opened(Limiter(0.5, min_size=100, grain=4, band=10), "a")
    limiter.count_inserts("a", 99)
    assert limiter.credit("a") is None and not limiter.allowed
    limiter.count_inserts("a", 1)
    assert limiter.credit("a") is not None and limiter.allowed


def test_updates_stop_at_the_ratio_and_continue_after_the_next_insert():
    limiter = opened(Limiter(0.5, min_size=10, grain=4), "a")
    limiter.count_inserts("a", 10)
    while limiter.allowed:
        limiter.take_batch()
    assert limiter.updates == 5
    limiter.count_inserts("a", 1)
    assert not limiter.allowed
    limiter.count_inserts("a", 1)
    assert limiter.allowed


def test_inserts_stop_without_updates():
    limiter = opened(Limiter(1.0, min_size=1, grain=4, band=16), "a")
    limiter.count_inserts("a", 1)
    total = 1
    while (more := limiter.credit("a") - total) > 0:
        limiter.count_inserts("a", more)
        total += more
    assert total <= 1 + 16 + 4
    limiter.take_batch()
    assert limiter.credit("a") == total + 1


def test_idle_streams_cannot_keep_a_late_stream_from_its_grain():
    limiter = opened(Limiter(0.1, min_size=1, grain=12, band=64), "hoarder")
    limiter.count_inserts("hoarder", 1)
    assert limiter.credit("hoarder") == 1 + 12 + 64
    limiter.open("second hoarder")
    assert limiter.credit("second hoarder") >= 12
    limiter.open("late")
    produced = 0
    for _ in range(100):
        while limiter.allowed:
            limiter.take_batch()
        assert limiter.credit("late") - produced >= 12
        produced += 12
        limiter.count_inserts("late", 12)


def test_streams_with_equal_counts_get_equal_credit():
    names = [f"actor/{i}" for i in range(7)]
    limiter = opened(Limiter(0.5, min_size=7, grain=3, band=70), *names)
    for name in names:
        limiter.count_inserts(name, 1)
    assert len({limiter.credit(name) for name in names}) == 1
    while limiter.allowed:
        limiter.take_batch()
    assert [limiter.credit(name) for name in names] == [1 + 3 + 10] * 7


def test_credit_of_a_closed_stream_returns_to_the_others():
    limiter = opened(Limiter(1.0, min_size=2, grain=2, band=20), "a", "b")
    limiter.count_inserts("a", 1)
    limiter.count_inserts("b", 1)
    before = limiter.credit("a")
    assert limiter.close("b") > 0
    assert limiter.credit("a") > before


def test_rejected_transitions_use_credit_but_earn_no_updates():
    limiter = opened(Limiter(1.0, min_size=1, grain=4, band=0), "a")
    limiter.count_inserts("a", 1)
    limiter.take_batch()
    before = limiter.credit("a")
    limiter.count_inserts("a", 0, rejected=4)
    assert limiter.credit("a") == before + 4 and not limiter.allowed


def test_totals_survive_a_restart_and_streams_do_not():
    limiter = opened(Limiter(0.5, min_size=10, grain=4), "a")
    limiter.count_inserts("a", 20)
    limiter.take_batch()
    resumed = Limiter(0.5, min_size=10, grain=4)
    resumed.restore(limiter.state(), same_run=False)
    assert (resumed.stored, resumed.updates, resumed.limited) == (20, 1, True)
    resumed.open("a")
    assert 4 <= resumed.credit("a") < limiter.credit("a")


def learned(limiter):
    """Take all batches that are allowed; return their number."""
    taken = 0
    while limiter.allowed:
        limiter.take_batch()
        taken += 1
    return taken


@pytest.mark.parametrize("ratio", [0.05, 0.25, 1.0, 4.0])
def test_another_ratio_counts_from_where_a_run_resumes_with_it(ratio):
    before = opened(Limiter(0.5, min_size=10, grain=4, band=8), "a")
    before.count_inserts("a", 1001)
    assert learned(before) == 500
    limiter = Limiter(ratio, min_size=10, grain=4, band=8)
    limiter.restore(json.loads(json.dumps(before.state())), same_run=False)
    assert not limiter.allowed, "neither a burst of updates, nor a debt"
    limiter.open("b")
    assert limiter.credit("b") <= 4 + 8 + 1 / ratio, "and the actors do not run ahead either"
    limiter.count_inserts("b", 100)
    assert learned(limiter) == 100 * ratio
    assert limiter.credit("b") >= 104
    again = Limiter(ratio, min_size=10, grain=4, band=8)
    again.restore(json.loads(json.dumps(limiter.state())), same_run=False)
    again.open("c")
    again.count_inserts("c", 100)
    assert learned(again) == 100 * ratio, "from the change on, also after another start"


def test_what_was_owed_at_a_change_of_the_ratio_remains_owed():
    before = opened(Limiter(0.5, min_size=10, grain=4, band=8), "a")
    before.count_inserts("a", 20)
    before.take_batch()
    limiter = Limiter(2.0, min_size=10, grain=4, band=8)
    limiter.restore(before.state(), same_run=False)
    assert limiter.allowed == 9


def test_in_a_state_of_an_earlier_version_the_ratio_begins_anew():
    limiter = Limiter(2.0, min_size=10, grain=4)
    limiter.restore({"stored": 1000, "updates": 250, "streams": {}}, same_run=False)
    limiter.open("a")
    limiter.count_inserts("a", 10)
    assert limiter.allowed == 20


def test_calls_that_contradict_the_counts_are_rejected():
    limiter = opened(Limiter(1.0, min_size=5, grain=1), "a")
    for wrong in (
        lambda: limiter.open("a"),
        lambda: limiter.close("b"),
        lambda: limiter.count_inserts("b", 1),
        lambda: limiter.credit("b"),
        limiter.take_batch,
    ):
        with pytest.raises(ProtocolError):
            wrong()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 1, 1, 0), "updates_per_insert is 0.0"),
        ((1.0, 0, 1, 0), "min_size is 0"),
        ((1.0, 1, 0, 0), "grain is 0"),
        ((1.0, 1, 1, -1), "band is -1"),
    ],
)
def test_counts_out_of_range_are_refused_by_name(arguments, message):
    with pytest.raises(ConfigError, match=message):
        Limiter(*arguments)


class PlainGrants:
    """Credit by the rule of `zsdist.replay.limiter`, counted anew over all streams each time."""

    def __init__(self, ratio, grain, band):
        self.ratio, self.grain, self.band = Fraction(str(ratio)), grain, band
        self.stored = self.updates = 0
        self.inserted, self.granted = {}, {}

    def ahead(self, name):
        return max(self.granted[name] - self.inserted[name], 0)

    def grant(self):
        names = list(self.inserted)
        room = int((self.updates + 1) / self.ratio) - self.stored + self.band
        room += sum(self.grain - self.ahead(name) for name in names)
        room -= self.top_up(self.grain, room)
        beyond = sum(max(self.ahead(name) - self.grain, 0) for name in names)
        self.top_up(self.grain + self.band // len(names), min(room, self.band - beyond))

    def top_up(self, level, room):
        lacking = {name: level - self.ahead(name) for name in self.inserted if self.ahead(name) < level}
        wanted, granted = sum(lacking.values()), 0
        for name, lack in lacking.items() if room > 0 else ():
            more = lack if room >= wanted else lack * room // wanted
            self.granted[name] = max(self.granted[name], self.inserted[name]) + more
            granted += more
        return granted


@pytest.mark.parametrize("ratio", [0.1, 0.5, 1.7])
def test_grants_are_those_of_a_count_over_all_streams(ratio):
    rng, opened_in_all, changed = random.Random(int(10 * ratio)), 0, True
    limiter, plain = Limiter(ratio, 30, 5, 40), PlainGrants(ratio, 5, 40)
    for _ in range(1500):
        names = sorted(plain.inserted)
        draw = rng.random()
        if not names or (draw < 0.03 and len(names) < 12):
            name, opened_in_all = f"s{opened_in_all}", opened_in_all + 1
            limiter.open(name)
            plain.inserted[name] = plain.granted[name] = 0
        elif draw < 0.05:
            name = rng.choice(names)
            assert limiter.close(name) == plain.ahead(name)
            del plain.inserted[name], plain.granted[name]
        elif draw < 0.5:
            name = rng.choice(names)
            most = plain.ahead(name) if limiter.limited else 9
            stored = rng.randint(0, most)
            limiter.count_inserts(name, stored, most - stored)
            plain.inserted[name] += most
            plain.stored += stored
        elif limiter.allowed and draw < 0.9:
            limiter.take_batch()
            plain.updates += 1
        elif limiter.limited:
            if changed:
                plain.grant()
            assert {name: limiter.credit(name) for name in names} == plain.granted
            changed = False
            continue
        changed = True
    assert plain.updates > 20


def work_for_a_grant(streams, updates):
    """Return the operations for a grant after one of many streams has inserted; `updates` were made before."""
    limiter = Limiter(1.0, 1, 8, 256)
    for index in range(streams):
        limiter.open(str(index))
    limiter.count_inserts("0", 1)
    for index in range(streams):
        limiter.count_inserts(str(index), limiter.credit(str(index)) or 0)
    for _ in range(updates):
        limiter.take_batch()
    limiter.credit("0")

    def once():
        limiter.count_inserts("0", 1)
        limiter.take_batch()
        limiter.credit("0")

    return operations(once)


@pytest.mark.parametrize("share", [0.0, 0.9], ids=["a slow learner", "a quick learner"])
def test_a_grant_takes_as_much_work_among_many_streams_as_among_few(share):
    few, many = (work_for_a_grant(streams, int(share * 8 * streams)) for streams in (16, 2048))
    assert many < 2 * few + 1000
