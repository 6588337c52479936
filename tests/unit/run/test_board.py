import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData

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


@pytest.mark.parametrize(
    ("figure", "tag"),
    [
        ("recent_success", "outcomes/recent_success"),
        ("env_steps_per_s", "actors/env_steps_per_s"),
        ("actors_cars_driving", "actors/cars_driving"),
        ("high_loss", "high/loss"),
        ("replay_low_size", "replay_low/size"),
        ("epsilon", "run/epsilon"),
    ],
)
def test_figures_are_in_groups(figure, tag):
    assert board.tag(figure) == tag


def test_runs_can_be_compared_by_their_settings(tmp_path):
    Board(tmp_path).add_settings("seed: 3", {"seed": 3, "low": {"double": True, "optimiser": "adam", "clip": None}})
    events = EventAccumulator(str(tmp_path)).Reload()
    (text,) = events.Tensors("configuration")
    assert b"seed: 3" in text.tensor_proto.string_val[0]
    content = events.SummaryMetadata("_hparams_/session_start_info").plugin_data.content
    settings = HParamsPluginData.FromString(content).session_start_info.hparams
    assert settings["seed"].number_value == 3 and settings["low.double"].bool_value
    assert settings["low.optimiser"].string_value == "adam" and "low.clip" not in settings


def test_a_row_takes_little_space(tmp_path):
    one, values = Board(tmp_path), {f"run/replay_high_figure_{number}": 1e6 * number for number in range(68)}
    one.add(0, values)
    (before,) = board.sizes(tmp_path).values()
    one.add(10**9, values)
    (after,) = board.sizes(tmp_path).values()
    assert after - before < 68 * 60
