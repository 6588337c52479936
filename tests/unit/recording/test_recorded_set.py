import json

import pytest
from recordings import record, recorded

from zsdist import config
from zsdist.errors import DataError
from zsdist.recording.recorded_set import RecordedSet
from zsdist.types import Level


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("set") / "set", 2)


def test_a_set_fits_the_configuration_that_it_was_recorded_under(made):
    made.check(config.Config())
    for level in Level:
        assert all(part.level is level for part in made.trajectories(level))


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("grid.blocks=8", r"grid\.blocks 4 and this run has 8"),
        ("low.discount=0.9", r"discounts\.low 0\.95 and this run has 0\.9"),
        ("reward.literal=true", r"literal_reward"),
    ],
)
def test_a_set_of_another_kind_is_refused_in_one_line_with_both_values(made, override, said):
    with pytest.raises(DataError, match=said) as refused:
        made.check(config.load(overrides=(override,)))
    assert "\n" not in str(refused.value) and str(made.folder) in str(refused.value)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (["features"], 0, "features 0 and this run has 1"),
        (["actions", 1, "turn_deg"], 30, r"actions\[1\]\.turn_deg 30 and this run has 45"),
        (["state_sizes", "high"], 7, r"state_sizes\.high 7"),
    ],
)
def test_a_set_of_other_features_or_actions_is_refused(made, tmp_path, path, value, said):
    tree = json.loads((made.folder / "set.json").read_text())
    *parents, last = ["transitions", *path]
    place = tree
    for key in parents:
        place = place[key]
    place[last] = value
    (tmp_path / "set.json").write_text(json.dumps(tree))
    (tmp_path / "episode-000000.mcap").touch()
    with pytest.raises(DataError, match=said):
        RecordedSet(tmp_path).check(config.Config())


def test_what_is_no_set_or_has_nothing_to_learn_from_is_refused(tmp_path):
    with pytest.raises(DataError, match=r"is not a recorded set \(set\.json: No such file"):
        RecordedSet(tmp_path)
    for content in ("", "{}", '{"format": 2}', "\0"):
        (tmp_path / "set.json").write_text(content)
        with pytest.raises(DataError, match="damaged or of another version"):
            RecordedSet(tmp_path)
    record(tmp_path / "a", 1, baseline="random")
    with pytest.raises(DataError, match="holds no transitions, since 'random' does not decide on two levels"):
        RecordedSet(tmp_path / "a").check(config.Config())
    record(tmp_path / "b", 0)
    with pytest.raises(DataError, match="holds 0 finished episodes"):
        RecordedSet(tmp_path / "b").check(config.Config())


def test_files_of_others_and_unfinished_ones_are_no_episodes(tmp_path):
    made = recorded(tmp_path / "set", 1)
    for name in (".episode-000001.mcap.partial", "episode-7.mcap", "episode-000002.mcap.bak"):
        (made.folder / name).touch()
    assert list(made.episodes()) == [0]


def test_a_damaged_episode_is_named(tmp_path):
    made = recorded(tmp_path / "set", 1)
    made.episodes()[0].write_bytes(b"nothing")
    with pytest.raises(DataError, match=r"episode-000000\.mcap is not a whole MCAP file"):
        list(made.trajectories(Level.LOW))
