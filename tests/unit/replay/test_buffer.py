from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zsdist.errors import RunError
from zsdist.replay import segments
from zsdist.replay.buffer import REASONS, RingBuffer, row_bytes
from zsdist.replay.priorities import SMALLEST_ERROR, RowPriorities
from zsdist.types import Level, Trajectory

STATE_SIZE, ACTIONS = 4, 5


def trajectory(n, first=0, version=0):
    """Return transitions numbered from `first`; every column encodes the number of its transition."""
    numbers = np.arange(first, first + n)
    return Trajectory(
        level=Level.LOW,
        states=np.repeat(np.arange(first, first + n + 1, dtype=np.float32)[:, None], STATE_SIZE, axis=1),
        actions=(numbers % ACTIONS).astype(np.uint8),
        rewards=numbers.astype(np.float32),
        discounts=np.full(n, 0.99, np.float32),
        successors=np.arange(1, n + 1, dtype=np.uint16),
        masks=np.ones((n + 1, ACTIONS), bool),
        guides=((numbers % (ACTIONS + 1)) - 1).astype(np.int8),
        behaviours=(numbers % 3).astype(np.uint8),
        weight_version=version,
    )


def held(buffer):
    """Return the sorted numbers of the stored transitions; check that all columns of a row belong to the same one."""
    state = buffer.state()
    numbers = state["rewards"].astype(int)
    assert (state["states"] == numbers[:, None]).all() and (state["next_states"] == numbers[:, None] + 1).all()
    assert (state["actions"] == numbers % ACTIONS).all() and (state["guides"] == numbers % (ACTIONS + 1) - 1).all()
    return sorted(numbers.tolist())


@settings(max_examples=60, deadline=None)
@given(
    capacity=st.integers(1, 12),
    operations=st.lists(
        st.one_of(st.tuples(st.just("insert"), st.integers(0, 15)), st.tuples(st.just("resize"), st.integers(1, 12))),
        max_size=15,
    ),
)
def test_the_ring_holds_exactly_the_newest_after_any_inserts_and_resizes(capacity, operations):
    buffer, offered, expected = RingBuffer(STATE_SIZE, ACTIONS, capacity), 0, []
    for what, amount in operations:
        if what == "insert":
            assert buffer.insert([trajectory(amount, offered, version=offered)]) == (amount, {})
            expected += range(offered, offered + amount)
            offered += amount
        else:
            buffer.resize(amount)
        expected = expected[-buffer.capacity :]
        buffer.check_valid()
        assert held(buffer) == expected and len(buffer) == len(expected)


def test_the_oldest_version_is_that_of_the_oldest_transition_still_held():
    buffer = RingBuffer(STATE_SIZE, ACTIONS, 6)
    assert buffer.oldest_version is None and buffer.oldest_age_versions is None
    for version in range(5):
        buffer.insert([trajectory(2, 2 * version, version)])
    assert (buffer.oldest_version, buffer.oldest_age_versions) == (2, 2)
    buffer.resize(3)
    assert (buffer.oldest_version, buffer.oldest_age_versions) == (3, 1)
    buffer.insert([trajectory(1, version=1)])  # from an actor with old weights
    assert (buffer.oldest_version, buffer.oldest_age_versions) == (4, 0)


def test_a_successor_may_be_any_later_state():
    buffer, option = RingBuffer(STATE_SIZE, ACTIONS, 9), trajectory(4)
    buffer.insert([replace(option, successors=np.full(4, 4, np.uint16))])
    assert (buffer.state()["next_states"] == 4).all()


def test_samples_are_whole_transitions_in_the_dtypes_of_storage():
    buffer = RingBuffer(STATE_SIZE, ACTIONS, 50)
    buffer.insert([trajectory(80)])
    batch = buffer.sample(np.random.default_rng(0), 400)
    assert (batch.states == batch.rewards[:, None]).all() and (batch.next_states == batch.rewards[:, None] + 1).all()
    assert (batch.actions == batch.rewards % ACTIONS).all()
    assert batch.masks.shape == batch.next_masks.shape == (400, ACTIONS)
    assert {name: value.dtype for name, value in vars(batch).items() if value is not None} == {
        "states": np.float16,
        "actions": np.uint8,
        "rewards": np.float32,
        "discounts": np.float32,
        "next_states": np.float16,
        "next_masks": np.bool_,
        "masks": np.bool_,
        "guides": np.int8,
    }
    batch.states[:] = -1
    buffer.check_valid()
    assert held(buffer) == list(range(30, 80))


def test_every_stored_transition_is_drawn_equally_often():
    buffer = RingBuffer(STATE_SIZE, ACTIONS, 20)
    buffer.insert([trajectory(27)])
    counts = np.bincount(buffer.sample(np.random.default_rng(1), 40_000).rewards.astype(int), minlength=27)
    assert (counts[:7] == 0).all()
    chi_square = ((counts[7:] - 2000) ** 2 / 2000).sum()
    assert chi_square < 43.8  # 19 degrees of freedom, p = 0.001


def test_an_n_step_return_ends_with_its_trajectory_and_before_a_rejected_transition():
    buffer = RingBuffer(STATE_SIZE, ACTIONS, 50, n_step=3)
    whole = spoiled("discounts", slice(None), 0.5)(trajectory(4, first=1))
    refused = spoiled("rewards", 2, np.nan)(spoiled("discounts", slice(None), 0.5)(trajectory(4, first=11)))
    assert buffer.insert([whole, refused]) == (7, {"reward": 1})
    state = buffer.state()
    assert state["states"][:, 0].tolist() == [1, 2, 3, 4, 11, 12, 14]
    assert state["rewards"].tolist() == [1 + 1 + 0.75, 2 + 1.5 + 1, 3 + 2, 4, 11 + 6, 12, 14]
    assert state["discounts"].tolist() == [0.125, 0.125, 0.25, 0.5, 0.25, 0.5, 0.5]
    assert state["next_states"][:, 0].tolist() == [4, 5, 5, 5, 13, 13, 15]
    buffer.check_valid()


def test_an_empty_buffer_has_nothing_to_sample():
    with pytest.raises(ValueError, match="holds 0 transitions"):
        RingBuffer(STATE_SIZE, ACTIONS, 5).sample(np.random.default_rng(0), 1)


def spoiled(column, row, value):
    def spoil(sound):
        changed = getattr(sound, column).copy()
        changed[row] = value
        return replace(sound, **{column: changed})

    return spoil


@pytest.mark.parametrize(
    ("reason", "spoil", "refused"),
    [
        ("shape", lambda t: replace(t, states=t.states[:, :-1]), 8),
        ("shape", lambda t: replace(t, rewards=t.rewards[:-1]), 8),
        ("shape", lambda t: replace(t, masks=t.masks[:-1]), 8),
        ("dtype", lambda t: replace(t, states=t.states.astype(np.float64)), 8),
        ("dtype", lambda t: replace(t, actions=t.actions.astype(np.int64)), 8),
        ("successor", spoiled("successors", 2, 9), 1),
        ("state", spoiled("states", 3, np.nan), 2),  # as a state and as a successor
        ("state", spoiled("states", 8, np.inf), 1),
        ("reward", spoiled("rewards", 0, -np.inf), 1),
        ("discount", spoiled("discounts", 0, 1.001), 1),
        ("discount", spoiled("discounts", 0, -0.1), 1),
        ("discount", spoiled("discounts", 0, np.nan), 1),
        ("action", spoiled("actions", 4, ACTIONS), 1),
        ("action_masked", spoiled("masks", (1, 1), False), 1),
        ("guide", spoiled("guides", 5, ACTIONS), 1),
        ("guide", spoiled("guides", 5, -2), 1),
        ("guide", lambda t: spoiled("guides", 5, 0)(spoiled("masks", (5, 0), False)(spoiled("actions", 5, 1)(t))), 1),
        ("behaviour", spoiled("behaviours", 7, 3), 1),
        ("dead_end", spoiled("masks", 8, False), 1),
    ],
)
def test_invalid_transitions_are_rejected_by_reason_and_the_counts_add_up(reason, spoil, refused):
    buffer = RingBuffer(STATE_SIZE, ACTIONS, 50)
    stored, rejected = buffer.insert([spoil(trajectory(8))])
    assert rejected == {reason: refused} and reason in REASONS
    assert stored == len(buffer) == 8 - refused
    buffer.check_valid()


def oldest_first(buffer):
    """Return the stored rows, independent of where the ring begins."""
    state = buffer.state()
    head, capacity, _ = (int(state.pop(name)) for name in ("head", "capacity", "written"))
    start = head if len(buffer) == capacity else 0
    return {name: np.roll(column, -start, axis=0).tolist() for name, column in state.items()}


@settings(max_examples=60, deadline=None)
@given(lengths=st.lists(st.integers(0, 9), max_size=6), capacity=st.integers(1, 30), faults=st.sets(st.integers(0, 5)))
def test_several_trajectories_at_once_are_stored_and_rejected_as_one_after_the_other(lengths, capacity, faults):
    offered = [trajectory(length, 100 * number, number) for number, length in enumerate(lengths)]
    for number in faults & {index for index, length in enumerate(lengths) if length}:
        spoil = (spoiled("rewards", 0, np.nan), spoiled("successors", 0, 99), spoiled("states", -1, np.inf))[number % 3]
        offered[number] = spoil(offered[number])
    together, apart = (RingBuffer(STATE_SIZE, ACTIONS, capacity) for _ in range(2))
    counts = [apart.insert([single]) for single in offered]
    stored, rejected = together.insert(offered)
    assert stored == sum(count for count, _ in counts)
    assert rejected == dict(sum((Counter(reasons) for _, reasons in counts), Counter()))
    assert oldest_first(together) == oldest_first(apart)
    together.check_valid()


def test_the_last_state_of_an_episode_may_allow_no_action():
    buffer, ended = RingBuffer(STATE_SIZE, ACTIONS, 50), trajectory(8)
    ended = spoiled("masks", 8, False)(spoiled("discounts", 7, 0)(ended))
    assert buffer.insert([ended]) == (8, {})


def test_several_faults_of_one_transition_count_once():
    both = spoiled("rewards", 2, np.nan)(spoiled("actions", 2, ACTIONS)(trajectory(8)))
    stored, rejected = RingBuffer(STATE_SIZE, ACTIONS, 50).insert([both])
    assert stored == 7 and rejected == {"reward": 1}


def test_bytes_follow_from_the_capacity():
    buffer = RingBuffer(120, ACTIONS, 1000)
    assert buffer.nbytes == 1000 * row_bytes(120, ACTIONS)
    buffer.resize(300)
    assert buffer.nbytes == 300 * row_bytes(120, ACTIONS) < 300 * 1000


def test_a_restored_buffer_gives_the_same_samples_and_evicts_in_the_same_order():
    buffer, restored = RingBuffer(STATE_SIZE, ACTIONS, 10), RingBuffer(STATE_SIZE, ACTIONS, 3)
    buffer.insert([trajectory(17)])
    restored.restore(buffer.state())
    restored.check_valid()
    for first in (17, 21):
        one, other = (b.sample(np.random.default_rng(5), 30) for b in (buffer, restored))
        assert all(np.array_equal(getattr(one, name), getattr(other, name)) for name in vars(one))
        buffer.insert([trajectory(4, first)])
        restored.insert([trajectory(4, first)])
    assert held(restored) == list(range(15, 25)) and restored.capacity == 10


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda s: s.pop("guides"), "lacks guides"),
        (lambda s: s.update(capacity=np.array(4)), "capacity 4, head 5, 5 rows"),
        (lambda s: s.update(head=np.array(2)), "head 2"),
        (lambda s: s.update(states=s["states"][:, :-1]), r"states is float16 of shape \(5, 3\)"),
        (lambda s: s.update(actions=s["actions"].astype(int)), "actions is int64"),
    ],
)
def test_a_state_that_contradicts_itself_is_refused_and_changes_nothing(spoil, message):
    source, buffer = RingBuffer(STATE_SIZE, ACTIONS, 8), RingBuffer(STATE_SIZE, ACTIONS, 8)
    source.insert([trajectory(5)])
    buffer.insert([trajectory(2)])
    state = source.state()
    spoil(state)
    with pytest.raises(RunError, match=message):
        buffer.restore(state)
    assert held(buffer) == [0, 1]


def prioritised(capacity):
    return RingBuffer(STATE_SIZE, ACTIONS, capacity, priorities=RowPriorities(capacity, 1.0, 1.0))


@settings(max_examples=60, deadline=None)
@given(
    capacity=st.integers(1, 12),
    operations=st.lists(st.tuples(st.sampled_from(["insert", "resize", "restore"]), st.integers(1, 15)), max_size=12),
)
def test_a_serial_identifies_its_transition_until_it_is_overwritten(capacity, operations):
    buffer, offered, serials = prioritised(capacity), 0, {}
    for what, amount in [("insert", 1), *operations]:
        if what == "insert":
            buffer.insert([trajectory(amount, offered)])
            offered += amount
        elif what == "resize":
            buffer.resize(amount)
        else:
            buffer, state = prioritised(3), buffer.state()
            buffer.restore(state)
        batch = buffer.sample(np.random.default_rng(0), 64)
        found = dict(zip(batch.rewards.astype(int).tolist(), batch.serials.tolist(), strict=True))
        assert all(serials.get(number, serial) == serial for number, serial in found.items())
        serials |= found
        assert len(set(serials.values())) == len(serials)
        numbers = np.array(sorted(serials))
        assert buffer.update_priorities(
            np.array([serials[number] for number in numbers]), (1 + numbers).astype(np.float32)
        ) == len(set(serials) & set(held(buffer)))
        state = buffer.state()
        known = np.isin(state["rewards"], numbers)
        np.testing.assert_allclose(state["priorities"][known], 1 + state["rewards"][known] + SMALLEST_ERROR, rtol=1e-6)


def test_rows_are_drawn_by_their_last_errors():
    buffer = prioritised(8)
    buffer.insert([trajectory(11)])
    batch = buffer.sample(np.random.default_rng(0), 64)
    errors = np.where(batch.rewards == 7, 50.0, 0.0).astype(np.float32)
    assert buffer.update_priorities(batch.serials, errors) == 64
    again = buffer.sample(np.random.default_rng(1), 1000)
    assert (again.rewards == 7).mean() > 0.99
    assert again.weights[again.rewards == 7].max() < 0.001 * again.weights.max()


def test_several_batches_at_once_are_drawn_as_one_after_the_other_would_be():
    for buffer in (RingBuffer(STATE_SIZE, ACTIONS, 8), prioritised(8)):
        buffer.insert([trajectory(11)])
        together, apart = (np.random.default_rng(3) for _ in range(2))
        batches = buffer.sample(together, 16, batches=5).parts(5)
        for drawn in batches:
            alone = buffer.sample(apart, 16)
            for name, column in vars(alone).items():
                np.testing.assert_array_equal(getattr(drawn, name), column)


def test_a_state_without_priorities_is_restored_with_equal_ones():
    plain, buffer = RingBuffer(STATE_SIZE, ACTIONS, 8), prioritised(3)
    plain.insert([trajectory(11)])
    buffer.restore(plain.state())
    counts = np.bincount(buffer.sample(np.random.default_rng(0), 800).rewards.astype(int), minlength=11)
    assert counts[3:].tolist() == [100] * 8


def test_without_priorities_a_batch_has_neither_weights_nor_serials():
    buffer = RingBuffer(STATE_SIZE, ACTIONS, 8)
    buffer.insert([trajectory(5)])
    batch = buffer.sample(np.random.default_rng(0), 4)
    assert batch.weights is None and batch.serials is None


@settings(max_examples=100, deadline=None)
@given(
    capacity=st.integers(1, 12),
    operations=st.lists(
        st.tuples(st.sampled_from(["insert", "insert", "resize", "fold"]), st.integers(1, 15)), max_size=20
    ),
    of=st.sampled_from([prioritised, lambda capacity: RingBuffer(STATE_SIZE, ACTIONS, capacity)]),
)
def test_a_ring_is_reassembled_from_its_layout_and_the_rows_of_each_piece(capacity, operations, of):
    ring, offered, folded = of(capacity), 0, 0
    kept = [(0, ring.rows_since(0))]
    for what, amount in [*operations, ("fold", 1)]:
        if what == "insert":
            ring.insert([trajectory(amount, offered)])
            offered += amount
        elif what == "resize":
            ring.resize(amount)
        else:
            rows = ring.rows_since(folded)
            kept.append((ring.written - len(rows["actions"]), rows))
            folded = ring.written
    before, (after, missing) = ring.state(), segments.join(ring.layout(), len(ring), kept)
    assert missing == 0
    assert before.keys() == after.keys()
    for name, column in before.items():
        np.testing.assert_array_equal(column, after[name])
    again = of(3)
    again.restore(after)
    again.check_valid()


@pytest.mark.parametrize("capacity", [20, 6, 5])
def test_a_ring_with_a_missing_piece_has_the_other_rows_in_their_order_under_new_serials(capacity):
    ring = RingBuffer(STATE_SIZE, ACTIONS, capacity)
    ring.insert([trajectory(3)])
    first = ring.rows_since(0)
    ring.insert([trajectory(3)])
    pieces = [(0, first), (5, ring.rows_since(5))]  # rows 3 and 4 are missing
    state, missing = segments.join(ring.layout(), len(ring), pieces)
    assert missing == 2
    again = RingBuffer(STATE_SIZE, ACTIONS, capacity)
    again.restore(state)
    again.check_valid()
    assert len(again) == min(capacity, 6) - 2 and again.written > ring.written + len(again)
    kept = [serial for serial in range(6 - len(ring), 6) if serial not in (3, 4)]
    whole = ring.rows_since(0)
    for name, column in again.rows_since(0).items():
        np.testing.assert_array_equal(column, whole[name][np.array(kept) - (6 - len(ring))])
    again.insert([trajectory(4)])
    again.check_valid()


def test_a_ring_of_which_all_pieces_are_missing_is_empty():
    ring = RingBuffer(STATE_SIZE, ACTIONS, 5)
    empty = ring.rows_since(0)
    ring.insert([trajectory(7)])
    state, missing = segments.join(ring.layout(), len(ring), [(0, empty)])
    again = RingBuffer(STATE_SIZE, ACTIONS, 5)
    again.restore(state)
    again.check_valid()
    assert (missing, len(again)) == (5, 0)
