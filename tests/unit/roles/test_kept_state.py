import numpy as np
import pytest

from zsdist.errors import RunError
from zsdist.roles.kept_state import KEEP_AFTER_S, KEEP_EVERY_S, SHARE, KeptState, MergeState
from zsdist.wire.messages import State


class Clock:
    def __init__(self, step_s=0.0):
        self.now, self.step_s = 0.0, step_s

    def __call__(self):
        self.now += self.step_s
        return self.now


def state(version, value=0.0):
    arrays = {"dqn/online/x": np.full(1000, value, np.float32)}
    return State("learner-low", {"version": version, "updates": 5}, arrays)


def keep(folder, epoch, made):
    kept = KeptState(folder, epoch)
    kept.keep(lambda: made, 0.0)
    return kept


def test_a_successor_finds_the_newest_state_bit_for_bit(tmp_path):
    first = keep(tmp_path / "k", 9, state(1, 1.0))
    first.keep(lambda: state(2, np.nan), 2.0)
    first.note_version(3)
    found, published = KeptState(tmp_path / "k", 10).recover()
    assert (found.meta, published) == (state(2).meta, 3)
    assert np.isnan(found.arrays["dqn/online/x"]).all()


def test_without_predecessors_there_is_nothing(tmp_path):
    kept = KeptState(tmp_path / "k", 9)
    assert kept.recover() == (None, 0)
    assert kept.damaged == []


def test_one_that_was_replaced_and_wakes_up_changes_nothing_that_its_successor_leaves(tmp_path):
    old = keep(tmp_path / "k", 9, state(1))
    new = keep(tmp_path / "k", 10, state(2, 2.0))
    new.note_version(20)
    old.keep(lambda: state(3, 3.0), 9.0)
    old.note_version(4)
    found, published = KeptState(tmp_path / "k", 11).recover()
    assert found.meta["version"] == 2 and published == 20
    assert (found.arrays["dqn/online/x"] == 2.0).all()


def test_one_bit_flipped_anywhere_is_noticed_and_never_a_traceback(tmp_path):
    rng = np.random.default_rng(0)
    keep(tmp_path / "k", 9, state(1))
    (path,) = (tmp_path / "k").glob("*.state")
    sound = path.read_bytes()
    for place in rng.integers(0, 8 * len(sound), 200):
        damaged = bytearray(sound)
        damaged[place // 8] ^= 1 << place % 8
        path.write_bytes(damaged)
        successor = KeptState(tmp_path / "k", 10)
        assert successor.recover() == (None, 0)
        assert successor.damaged == [path.name]
    for length in (0, 1, len(sound) // 2, len(sound) - 1):
        path.write_bytes(sound[:length])
        assert KeptState(tmp_path / "k", 10).recover() == (None, 0)


def test_an_older_state_is_used_where_the_newest_is_damaged(tmp_path):
    keep(tmp_path / "k", 9, state(1))
    content = next((tmp_path / "k").glob("*.state")).read_bytes()
    keep(tmp_path / "k", 10, state(2))
    (newest,) = (tmp_path / "k").glob("*.state")
    newest.with_name(newest.name.replace("10", "09")).write_bytes(content)
    newest.write_bytes(b"rubbish")
    successor = KeptState(tmp_path / "k", 11)
    assert successor.recover()[0].meta["version"] == 1
    assert successor.damaged == [newest.name]


@pytest.mark.parametrize(("cost_s", "every_s"), [(0.001, KEEP_EVERY_S), (0.3, 0.3 / SHARE), (9.0, KEEP_AFTER_S)])
def test_a_state_that_takes_long_to_write_is_kept_more_rarely(tmp_path, cost_s, every_s):
    kept = KeptState(tmp_path / "k", 9, Clock(cost_s))
    assert kept.is_due(100.0)
    kept.keep(lambda: state(1), 100.0)
    assert not kept.is_due(100.0 + 0.99 * every_s)
    assert kept.is_due(100.0 + 1.01 * every_s)


def test_a_folder_that_cannot_be_written_ends_the_run_with_its_name(tmp_path):
    (tmp_path / "k").write_text("a file")
    with pytest.raises(RunError, match=r"kept state .* cannot be created"):
        KeptState(tmp_path / "k", 9)
    kept = KeptState(tmp_path / "l", 9)
    kept.discard()
    with pytest.raises(RunError, match=r"kept state .* cannot be written: No such file"):
        kept.keep(lambda: state(1), 0.0)


def test_the_candidates_of_a_merge_are_kept_apart_from_the_state(tmp_path):
    candidates = {name: {"output.bias": np.full(2, value)} for name, value in (("recent", 1.0), ("best", 2.0))}
    merge = MergeState(4, candidates, True)
    kept = KeptState(tmp_path / "k", 9)
    kept.keep(lambda: merge.added_to(state(1)), 0.0)
    found, _ = KeptState(tmp_path / "k", 10).recover()
    again = MergeState.of(found)
    assert (again.offered, again.paused, list(again.candidates)) == (4, True, ["recent", "best"])
    assert (again.candidates["best"]["output.bias"] == 2.0).all()
    assert MergeState.of(state(1)) is None
