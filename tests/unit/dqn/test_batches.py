import numpy as np
from learner_batches import ACTIONS, MIRROR, batch, same_arrays

from zsdist.dqn.batches import StackedBatch, from_stored
from zsdist.types import StoredBatch


def reflected(data, rows):
    columns = StackedBatch.of(data)
    columns.reflect(MIRROR, rows)
    return columns


def test_reflecting_twice_changes_nothing_and_once_changes_only_the_chosen_rows():
    data, rows = batch(2), np.arange(32) % 2 == 0
    once, twice = reflected(data, rows), reflected(data, rows)
    twice.reflect(MIRROR, rows)
    for columns in (twice, reflected(data, ~rows & rows)):
        assert all(np.array_equal(one, other) for one, other in zip(columns, StackedBatch.of(data), strict=True))
    both = np.tile(rows, 2)
    assert np.array_equal(once.states[~both], np.concatenate((data.states, data.next_states))[~both])
    for before, after in ((data.states[0], once.states[0]), (data.next_states[0], once.states[32])):
        np.testing.assert_array_equal(after, before[[1, 0, 2, 3, 5, 4]] * [1, 1, -1, 1, 1, 1])
    assert once.masks[:32][rows, once.actions[rows]].all()
    assert (once.guides[data.guides < 0] == -1).all()
    assert np.array_equal(once.masks[0], data.masks[0][[0, 2, 1, 4, 3]])


def test_reflecting_leaves_the_batch_as_it_is():
    data, same = batch(2), batch(2)
    reflected(data, np.ones(32, bool))
    assert same_arrays(data.__dict__, same.__dict__)


def test_a_learner_gets_stored_values_in_its_own_dtypes():
    data = batch(3)
    halves = {name: getattr(data, name).astype(np.float16) for name in ("states", "next_states")}
    small = {"actions": data.actions.astype(np.uint8), "guides": data.guides.astype(np.int8)}
    stored = StoredBatch(**{**vars(data), **halves, **small})
    learned = from_stored(stored)
    expected = vars(data) | {name: half.astype(np.float32) for name, half in halves.items()}
    assert all(np.array_equal(column, expected[name]) for name, column in vars(learned).items())
    dtypes = {name: column.dtype for name, column in vars(learned).items() if column is not None}
    assert dtypes == {name: column.dtype for name, column in vars(data).items() if column is not None}
    assert len(stored) == len(learned) == len(data) and data.masks.shape[1] == ACTIONS
