import json

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.util.tensor_util import make_ndarray

from zsdist import config
from zsdist.errors import RunError, WeightsError
from zsdist.run import directory
from zsdist.run.checkpoint import load_policy
from zsdist.run.directory import RunDirectory
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire.messages import State

SEEN = VisionIdentity("clip/b", "a" * 64, "head", "b" * 64)
META = {"finished": [1, 2, 4], "wall_s": 3.0}


@pytest.fixture
def folder(tmp_path):
    return directory.create(tmp_path / "run", config.Config())


@pytest.fixture
def ledger(folder):
    return RunDirectory(folder, SEEN)


def states(value=1.0):
    return {"scheduler": State("scheduler", META, {}), "replay": State("replay", {}, {"ring": np.full(3, value)})}


def test_tensorboard_finds_episodes_and_metrics(folder, ledger):
    for number in (1, 2):
        ledger.episode({"finished_as": number, "return": 10.0 * number, "steps": 7, "epsilon": 0.5})
    ledger.metrics({"time_s": 1.0, "env_steps": 14, "low_loss": 0.25, "stage": "train"})
    ledger.summary({})
    events = EventAccumulator(str(folder / "tensorboard")).Reload()

    def curve(tag):
        return [(event.step, float(make_ndarray(event.tensor_proto))) for event in events.Tensors(tag)]

    assert curve("episode/return") == [(1, 10.0), (2, 20.0)]
    assert curve("run/low_loss") == [(14, 0.25)]
    assert set(events.Tags()["tensors"]) == {
        "episode/return", "episode/steps", "episode/epsilon", "run/env_steps", "run/low_loss"
    }  # fmt: skip
    summary = events.SummaryMetadata("run/low_loss")
    assert summary.plugin_data.plugin_name == "scalars"


def test_epochs_are_never_issued_twice(folder):
    issued = [epoch for count in (3, 1, 5) for epoch in directory.issue_epochs(folder, count)]
    assert issued == list(range(issued[0], issued[0] + 9))


def test_epochs_of_two_runs_have_nothing_in_common(tmp_path):
    runs = [directory.create(tmp_path / name, config.Config()) for name in ("one", "other")]
    one, other = (set(directory.issue_epochs(folder, 1000)) for folder in runs)
    assert not one & other
    assert max(one | other) < 2**53  # exact also for readers of JSON that know floats alone


def test_a_checkpoint_reads_back_as_it_was_written_and_the_newest_wins(folder, ledger):
    for episodes in (5, 10, 100):
        ledger.checkpoint(episodes, states(episodes))
    newest = directory.newest_checkpoint(folder)
    assert newest.name == "00000100"
    read = directory.read_checkpoint(newest)
    assert read["scheduler"].meta == META
    np.testing.assert_array_equal(read["replay"].arrays["ring"], np.full(3, 100.0))


def test_a_checkpoint_says_by_what_its_policy_saw(folder, ledger):
    ledger.checkpoint(5, states())
    assert directory.read_vision(directory.newest_checkpoint(folder)) == SEEN


@pytest.mark.parametrize("vision", [None, {"encoder": "clip/b"}, "clip/b"])
def test_a_checkpoint_that_does_not_say_what_its_policy_saw_by_is_refused(folder, ledger, vision):
    ledger.checkpoint(5, states())
    path = directory.newest_checkpoint(folder) / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"vision": vision}))
    with pytest.raises(RunError, match="does not say which encoder"):
        directory.read_vision(path.parent)
    with pytest.raises(WeightsError, match="does not say which encoder"):
        load_policy(folder)


def test_only_the_newest_checkpoints_are_kept(folder, ledger):
    for episodes in range(10):
        ledger.checkpoint(episodes, states())
    kept = sorted(path.name for path in (folder / "checkpoints").iterdir())
    assert kept == ["00000007", "00000008", "00000009"]


@pytest.mark.parametrize(
    "damage", [lambda data: data[:-1], lambda data: data[:20] + b"x" + data[21:], lambda data: b""]
)
def test_a_damaged_checkpoint_is_refused_by_file(folder, ledger, damage):
    ledger.checkpoint(1, states())
    file = folder / "checkpoints" / "00000001" / "replay.state"
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(RunError, match=r"replay\.state is damaged"):
        directory.read_checkpoint(file.parent)


def test_a_checkpoint_without_a_file_is_refused_by_file(folder, ledger):
    ledger.checkpoint(1, states())
    (folder / "checkpoints" / "00000001" / "replay.state").unlink()
    with pytest.raises(RunError, match=r"replay\.state"):
        directory.read_checkpoint(folder / "checkpoints" / "00000001")


def test_going_on_strikes_out_episodes_that_the_checkpoint_does_not_know(folder, ledger):
    for episode in (1, 2, 3, 4, 5):
        ledger.episode({"episode": episode, "return": 0.0, "steps": 1, "epsilon": 1.0, "finished_as": episode})
    with (folder / "episodes.jsonl").open("a") as file:
        file.write('{"episode": 6, "retu')  # what a killed process leaves
    ledger.checkpoint(3, states())
    settings, read = directory.reopen(folder)
    directory.rewind(folder, settings, read)
    lines = (folder / "episodes.jsonl").read_text().splitlines()
    assert [json.loads(line)["episode"] for line in lines] == META["finished"]


def test_going_on_strikes_out_figures_of_later_and_the_line_that_was_not_finished(folder, ledger):
    rows = [{"time_s": 0.0}, *({"time_s": 1.0, "episodes": count, "env_steps": count} for count in (1, 3, 4, 6))]
    for row in rows:
        ledger.metrics(row)
    with (folder / "metrics.jsonl").open("a") as file:
        file.write('{"time_s": 2.0, "epi')
    ledger.checkpoint(3, states())
    directory.rewind(folder, *directory.reopen(folder))
    lines = (folder / "metrics.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in lines] == rows[:3]


@pytest.mark.parametrize("change", ["seed=4", "grid.blocks=8", "high.hidden=[64]", "low.hidden=[64]"])
def test_what_would_make_another_run_of_it_is_refused_by_name_and_nothing_changes(folder, ledger, change):
    ledger.checkpoint(3, states())
    before = (folder / "config.yaml").read_bytes()
    with pytest.raises(RunError, match=rf"{change.partition('=')[0]} is .*; allowed is what the run was begun with"):
        directory.reopen(folder, (change,))
    assert (folder / "config.yaml").read_bytes() == before


def test_where_the_newest_checkpoint_is_damaged_the_refusal_says_what_there_is_instead(folder, ledger):
    for count in (1, 2, 3):
        ledger.checkpoint(count, states())
    newest = folder / "checkpoints" / "00000003"
    (newest / "replay.state").write_bytes(b"")
    with pytest.raises(RunError, match=rf"is damaged.*; without {newest} the run goes on from 00000002"):
        directory.reopen(folder)


def test_a_checkpoint_of_as_many_episodes_takes_the_place_of_the_one_before(folder, ledger):
    ledger.checkpoint(3, states(1.0))
    left_over = folder / "checkpoints" / ".00000003.old"  # by a kill at the same place
    left_over.mkdir()
    (left_over / "replay.state").touch()
    ledger.checkpoint(3, states(2.0))
    (only,) = (folder / "checkpoints").iterdir()
    np.testing.assert_array_equal(directory.read_checkpoint(only)["replay"].arrays["ring"], np.full(3, 2.0))


@pytest.mark.parametrize(("summary", "ended"), [('{"ended": "complete"}', "complete"), (None, None)])
def test_how_a_run_ended_is_in_its_summary(folder, summary, ended):
    if summary:
        (folder / "summary.json").write_text(summary)
    assert directory.ended(folder) == ended


@pytest.mark.parametrize("summary", ["", "[]", "{}"])
def test_a_summary_that_is_none_is_refused(folder, summary):
    (folder / "summary.json").write_text(summary)
    with pytest.raises(RunError, match="is not a run's summary"):
        directory.ended(folder)


def test_the_configuration_comes_back_with_overrides_and_nothing_else_changed(folder, ledger):
    ledger.checkpoint(3, states())
    settings, _ = directory.reopen(folder, ("run.episodes=7",))
    assert settings.run.episodes == 7
    assert config.parse(settings.model_dump() | {"run": config.Config().run.model_dump()}) == config.Config()


def test_a_policy_cannot_be_had_where_there_are_no_weights(folder, ledger):
    with pytest.raises(WeightsError, match="no weights"):
        load_policy(folder)
    ledger.checkpoint(1, states())
    with pytest.raises(WeightsError, match="high"):
        load_policy(folder)


@pytest.mark.parametrize(("name", "key"), [("plain-1.2", "plain-1.2"), ("with space/ä", "-")])
def test_every_folder_has_a_name_that_a_key_can_hold(tmp_path, name, key):
    (tmp_path / name).mkdir(parents=True)
    assert directory.key_name(tmp_path / name) == key
