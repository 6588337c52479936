from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from zsdist.run import board
from zsdist.run.board import Board


def steps(folder, tag="run/loss"):
    return [event.step for event in EventAccumulator(str(folder)).Reload().Tensors(tag)]


def test_the_starts_of_a_run_follow_each_other(tmp_path):
    for start in range(3):
        Board(tmp_path).add(start, {"run/loss": 1.0})
    assert steps(tmp_path) == [0, 1, 2]


def test_a_rewind_keeps_exactly_what_was_there(tmp_path):
    one = Board(tmp_path)
    one.add(1, {"run/loss": 1.0})
    before = board.sizes(tmp_path)
    one.add(2, {"run/loss": 2.0})
    Board(tmp_path).add(3, {"run/loss": 3.0})
    board.rewind(tmp_path, before)
    assert board.sizes(tmp_path) == before and steps(tmp_path) == [1]
    board.rewind(tmp_path, {name: size + 10 for name, size in before.items()})  # the end was lost in a power failure
    assert board.sizes(tmp_path) == before


def test_a_checkpoint_of_an_earlier_version_leaves_all_events(tmp_path):
    Board(tmp_path).add(1, {"run/loss": 1.0})
    board.rewind(tmp_path, None)
    assert steps(tmp_path) == [1]


def test_a_row_takes_little_space(tmp_path):
    one, values = Board(tmp_path), {f"run/replay_high_figure_{number}": 1e6 * number for number in range(68)}
    one.add(0, values)
    (before,) = board.sizes(tmp_path).values()
    one.add(10**9, values)
    (after,) = board.sizes(tmp_path).values()
    assert after - before < 68 * 60
