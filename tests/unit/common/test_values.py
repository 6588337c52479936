"""The type of a setting decides what its text means, in `--set`, in configuration files and in scene files alike."""

import json
from operator import attrgetter

import pytest

from zsdist import config
from zsdist.common import strict_yaml
from zsdist.errors import ConfigError
from zsdist.sim.scenes import scene

READ = [
    ("seed", "010", 10),
    ("seed", "1_000", 1000),
    ("seed", "1e3", 1000),
    ("seed", " 7 ", 7),
    ("run.name", "2026-11-30", "2026-11-30"),
    ("run.name", "010", "010"),
    ("run.name", "true", "true"),
    ("run.name", "null", "null"),
    ("run.name", "1e3", "1e3"),
    ("run.name", "12.30", "12.30"),
    ("run.standby", "off", False),
    ("run.standby", "no", False),
    ("run.standby", "True", True),
    ("run.address", "null", None),
    ("run.address", "~", None),
    ("transport.tls", "~", None),
    ("low.learning_rate", "1e-3", 0.001),
    ("low.learning_rate", ".5", 0.5),
    ("replay.target_return", "1_0.5", 10.5),
    ("reward.goal", "-3", -3.0),
    ("low.hidden", "[010, 1e1]", (10, 10)),
    ("low.hidden", "8", (8,)),
    ("vision.weights", "/x/w#2", "/x/w#2"),
]
REFUSED = [
    ("run.actors", "true"),
    ("run.actors", "on"),
    ("run.actors", "2.5"),
    ("run.actors", "0x10"),
    ("run.actors", "0o10"),
    ("run.actors", "12:30"),
    ("run.actors", "null"),
    ("run.actors", ""),
    ("run.actors", "2026-11-30"),
    ("low.learning_rate", "yes"),
    ("low.learning_rate", "12:30:00"),
    ("low.learning_rate", "nan"),
    ("low.learning_rate", ".inf"),
    ("low.learning_rate", "1e999"),
    ("low.hidden", "[8, true]"),
    ("run.standby", "maybe"),
    ("run.standby", "2"),
    ("run.name", ""),
    ("vision.encoder", "''"),
]
TEXTS_BY_OPTION = [  # that YAML would not take for one text
    ("/x/w #2", "/x/w #2"),
    ("'/x/w #2'", "/x/w #2"),
    ('"/x/\\u00e4"', "/x/ä"),
    ("/x/[a]=b: c", "/x/[a]=b: c"),
    ("/x/it's", "/x/it's"),
    ("/*&!%@`|>", "/*&!%@`|>"),
    ("/x, y", "/x, y"),
    ("  /x/y ", "/x/y"),
    ('"/x/ y "', "/x/ y "),
    ("\"/x/'y'\"", "/x/'y'"),
]


def by_file(tmp_path, key, text):
    section, _, name = key.rpartition(".")
    (tmp_path / "c.yaml").write_text(f"{section}:\n  {name}: {text}\n" if section else f"{name}: {text}\n")
    return config.load(tmp_path / "c.yaml")


def ways(tmp_path, key, text):
    yield lambda: config.load(None, (f"{key}={text}",))
    yield lambda: by_file(tmp_path, key, text)


@pytest.mark.parametrize(("key", "text", "value"), READ)
def test_a_text_is_read_as_its_setting_asks(tmp_path, key, text, value):
    for load in ways(tmp_path, key, text):
        found = attrgetter(key)(load())
        assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(("key", "text"), REFUSED)
def test_a_text_that_is_no_value_of_its_setting_is_refused_in_one_line_with_its_name(tmp_path, key, text):
    for load in ways(tmp_path, key, text):
        with pytest.raises(ConfigError, match=rf"^{key}") as refused:
            load()
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("text", "value"), TEXTS_BY_OPTION)
def test_an_override_of_a_text_is_taken_whole(text, value):
    assert config.load(None, (f"vision.weights={text}",)).vision.weights == value
    if "," not in text:
        assert config.load(None, (f"scenes.train=[iid, {text}]",)).scenes.train == ("iid", value)
    assert config.load(None, (f"scenes.test={json.dumps([value])}",)).scenes.test == (value,)


def test_spaces_around_key_and_value_do_not_count_and_sections_are_merged():
    settings = config.load(None, (" run.episodes = 3 ", "run={actors: 5}", "transport={kind: zenoh}"))
    assert (settings.run.episodes, settings.run.actors) == (3, 5)


def test_a_section_without_settings_is_one_at_its_defaults(tmp_path):
    (tmp_path / "c.yaml").write_text("run:\n  # episodes: 3\nseed: 4\ntransport: {tls: null}\n")
    assert config.load(tmp_path / "c.yaml") == config.load(None, ("seed=4",))


def test_every_text_survives_being_kept(tmp_path):
    for name in ("2026-11-30", "010", "no", "null", "1e3", "0x10"):
        (tmp_path / "kept.yaml").write_text(config.dump(config.load(None, (f"run.name={name}",))))
        assert config.load(tmp_path / "kept.yaml").run.name == name


def test_a_truth_value_is_no_number_for_callers_either():
    with pytest.raises(ConfigError, match=r"run\.actors is True"):
        config.parse({"run": {"actors": True}})


def test_scene_files_are_read_in_the_same_way(tmp_path):
    text = "version: 1\nname: 2026-11-30\nground: sand\nstart: {x: 0_1, y: 009, heading_deg: 1e1}\n"
    (tmp_path / "s.yaml").write_text(text + "goal: {x: .5, y: -8}\nobstacles: []\n")
    read = scene.read(tmp_path / "s.yaml")
    assert (read.name, read.start.y_m, read.start.heading_deg, read.goal[0]) == ("2026-11-30", 9.0, 10.0, 0.5)


def test_yaml_is_texts_in_lists_and_mappings():
    assert strict_yaml.load("a: [1, no, ~, 'x']\n1: {b: 12:30}") == {"a": ["1", "no", "~", "x"], "1": {"b": "12:30"}}
