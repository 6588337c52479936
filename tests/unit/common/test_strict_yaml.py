import pytest
import yaml

from zsdist import config
from zsdist.common import strict_yaml
from zsdist.errors import ConfigError

TWICE = "run:\n  episodes: 3\n  actors: 2\n  episodes: 4\n"


def test_a_key_that_is_there_twice_is_refused_with_its_line():
    with pytest.raises(strict_yaml.DuplicateKeyError, match="line 4: key 'episodes' appears twice"):
        strict_yaml.load(TWICE)
    with pytest.raises(strict_yaml.DuplicateKeyError, match="line 1: key 'a' appears twice"):
        strict_yaml.load("{a: 1, a: 1}")


@pytest.mark.parametrize("text", ["a: x\nb: {a: y}\nc: [{a: z}, {a: 'w'}]", "", "x", "a: &n {b: c}\nd: {<<: *n}"])
def test_everything_else_is_read_as_plain_yaml(text):
    assert strict_yaml.load(text) == yaml.safe_load(text)


@pytest.mark.parametrize("tag", ["int", "float", "bool", "timestamp", "str"])
def test_a_tag_does_not_change_what_is_written(tag):
    assert strict_yaml.load(f'a: !!{tag} "010"') == {"a": "010"}


def test_a_configuration_file_with_a_key_twice_is_refused_in_one_line(tmp_path):
    file = tmp_path / "config.yaml"
    file.write_text(TWICE)
    with pytest.raises(ConfigError, match=r"config\.yaml is not valid YAML: line 4: key 'episodes' appears twice"):
        config.load(file)
