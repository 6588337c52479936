import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from zsdist.replay.buffer import RingBuffer, row_bytes
from zsdist.replay.priorities import RowPriorities
from zsdist.types import Level, Trajectory

STATE_SIZE, ACTIONS = 2, 3
ROW = row_bytes(STATE_SIZE, ACTIONS)


def trajectory(n, first):
    """Return transitions whose rewards are their numbers from `first` on."""
    numbers = np.arange(first, first + n)
    return Trajectory(
        level=Level.LOW,
        states=np.repeat(np.arange(first, first + n + 1, dtype=np.float32)[:, None], STATE_SIZE, axis=1),
        actions=(numbers % ACTIONS).astype(np.uint8),
        rewards=numbers.astype(np.float32),
        discounts=np.full(n, 0.99, np.float32),
        successors=np.arange(1, n + 1, dtype=np.uint16),
        masks=np.ones((n + 1, ACTIONS), bool),
        guides=np.full(n, -1, np.int8),
        behaviours=np.zeros(n, np.uint8),
        weight_version=first,
    )


operation = st.one_of(
    st.tuples(st.just("insert"), st.integers(1, 9)),
    st.tuples(st.just("advance"), st.integers(1, 4)),
    st.tuples(st.just("resize"), st.integers(1, 12)),
)


@settings(max_examples=150, deadline=None)
@given(
    capacity=st.integers(1, 12),
    before=st.lists(st.integers(1, 9), max_size=4),
    during=st.lists(operation, max_size=12),
    prioritised=st.booleans(),
)
def test_a_copy_is_the_state_at_its_beginning_whatever_is_added_or_resized_while_it_is_made(
    capacity, before, during, prioritised
):
    buffer = RingBuffer(STATE_SIZE, ACTIONS, capacity, 1, RowPriorities(capacity, 0.6, 0.4) if prioritised else None)
    first = 0
    for n in before:
        buffer.insert([trajectory(n, first)])
        first += n
    expected, copy = buffer.state(), buffer.begin_copy()
    for name, n in during:
        if name == "insert":
            buffer.insert([trajectory(n, first)])
            first += n
        elif name == "resize":
            buffer.resize(n)
        else:
            assert copy.advance(n * ROW) <= n * ROW
    while not copy.done:
        assert copy.advance(1) == ROW
    found = copy.arrays()
    assert found.keys() == expected.keys()
    assert all(np.array_equal(array, found[name]) for name, array in expected.items())
    restored = RingBuffer(STATE_SIZE, ACTIONS, 1, 1, RowPriorities(1, 0.6, 0.4) if prioritised else None)
    restored.restore(found)
    restored.check_valid()
