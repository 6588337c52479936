import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zsdist.replay.priorities import SMALLEST_ERROR, RowPriorities, SumTree


@settings(max_examples=80, deadline=None)
@given(
    size=st.integers(1, 40),
    changes=st.lists(
        st.lists(
            st.tuples(st.integers(0, 39), st.floats(0, 1e6, allow_subnormal=False)),  # as half of 5e-324 is 0
            min_size=1,
            max_size=8,
        ),
        max_size=8,
    ),
)
def test_the_total_is_the_sum_and_a_mass_is_found_at_its_number(size, changes):
    tree, values = SumTree(size), np.zeros(size)
    for change in changes:
        last = {place % size: value for place, value in change}
        tree[np.array(list(last))] = np.array(list(last.values()))
        for place, value in last.items():
            values[place] = value
    assert tree.total == pytest.approx(values.sum())
    assert np.array_equal(tree[np.arange(size)], values)
    if values.sum():
        middles = values.cumsum() - values / 2
        chosen = np.flatnonzero(values > 1e-6 * values.sum())
        assert np.array_equal(tree.find(middles[chosen]), chosen)


@settings(max_examples=80, deadline=None)
@given(size=st.integers(1, 40), data=st.data())
def test_filling_a_span_sets_every_sum_as_setting_its_numbers_does(size, data):
    filled, numbered = SumTree(size), SumTree(size)
    for value in data.draw(st.lists(st.floats(0, 1e6), max_size=8)):
        start = data.draw(st.integers(0, size - 1))
        stop = data.draw(st.integers(start + 1, size))
        filled.fill(start, stop, value)
        numbered[np.arange(start, stop)] = value
    nodes = np.arange(size)
    assert filled.total == numbered.total and np.array_equal(filled[nodes], numbered[nodes])
    if filled.total:
        masses = np.linspace(0, filled.total, 50, endpoint=False)
        assert np.array_equal(filled.find(masses), numbered.find(masses))


def test_the_last_of_two_values_for_an_index_counts():
    tree = SumTree(5)
    tree[np.array([3, 1, 3])] = np.array([7.0, 2.0, 4.0])
    assert tree.total == 6.0


def test_a_mass_at_the_very_end_is_not_found_at_a_number_of_0():
    tree = SumTree(8)
    tree[np.array([0, 1, 2])] = np.array([0.1, 0.2, 0.3])
    assert tree.find(np.array([tree.total, 2 * tree.total])).tolist() == [2, 2]
    assert tree.find(np.array([0.0])).tolist() == [0]


@pytest.mark.parametrize("exponent", [0.0, 0.6, 1.0])
def test_rows_are_drawn_in_proportion_to_their_priorities(exponent):
    rng, errors = np.random.default_rng(0), np.array([0.0, 0.5, 1.0, 2.0, 8.0], np.float32)
    priorities = RowPriorities(9, exponent, 0.4)
    priorities.add(0, 5)
    priorities.update(np.arange(5), errors)
    drawn = np.concatenate([priorities.draw(rng, 4, 5)[0] for _ in range(10_000)])
    counts = np.bincount(drawn, minlength=9)
    expected = (errors + SMALLEST_ERROR) ** exponent
    expected = 40_000 * expected / expected.sum()
    assert (counts[5:] == 0).all()
    assert ((counts[:5] - expected) ** 2 / expected).sum() < 18.5  # 4 degrees of freedom, p = 0.001


def test_importance_weights_correct_the_bias_of_the_priorities():
    rng, values = np.random.default_rng(1), np.array([3.0, -1.0, 5.0, 10.0])
    priorities = RowPriorities(4, 1.0, 1.0)
    priorities.update(np.arange(4), np.array([0.1, 1.0, 2.0, 4.0], np.float32))
    places, weights = priorities.draw(rng, 200_000, 4)
    assert weights.dtype == np.float32 and weights.max() == 1.0
    assert (weights * values[places]).sum() / weights.sum() == pytest.approx(values.mean(), rel=0.02)


def test_equal_priorities_have_equal_weights():
    priorities = RowPriorities(6, 0.6, 0.4)
    priorities.add(0, 6)
    _, weights = priorities.draw(np.random.default_rng(0), 64, 6)
    assert (weights == 1.0).all()


def test_new_rows_have_the_largest_priority_so_far():
    priorities = RowPriorities(4, 1.0, 0.4)
    priorities.add(0, 1)
    priorities.update(np.array([0]), np.array([9.0], np.float32))
    priorities.update(np.array([0]), np.array([2.0], np.float32))
    priorities.add(1, 2)
    assert priorities.get(np.arange(4)).tolist() == pytest.approx([2 + SMALLEST_ERROR, 9 + SMALLEST_ERROR, 0, 0])


def test_no_weight_is_zero_however_unequal_the_priorities():
    priorities = RowPriorities(2, 1.0, 1.0)
    priorities.update(np.array([0, 1]), np.array([0.0, np.finfo(np.float32).max]))
    _, weights = priorities.draw(np.random.default_rng(0), 1000, 2)
    assert (weights > 0).all() and np.isfinite(weights).all()


@pytest.mark.parametrize("size", [1_000, 32_000])
def test_drawing_and_updating_touch_as_many_sums_as_rows_times_depth(size, monkeypatch):
    touched = []
    unique = np.unique
    monkeypatch.setattr(np, "unique", lambda nodes: touched.append(len(nodes)) or unique(nodes))
    priorities = RowPriorities(size, 0.6, 0.4)
    priorities.add(0, size)
    touched.clear()
    priorities.update(np.arange(0, size, size // 100)[:100], np.ones(100, np.float32))
    assert sum(touched) <= 100 * np.ceil(np.log2(size))
