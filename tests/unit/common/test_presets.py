from pathlib import Path

import pytest

from zsdist import config
from zsdist.common import presets
from zsdist.errors import ConfigError

CONFIGS = Path(__file__).parents[3] / "configs"
FILES = sorted((*CONFIGS.glob("*.yaml"), *CONFIGS.glob("baselines/*.yaml")))


def test_every_configuration_of_the_checkout_is_a_preset_and_names_mean_one_thing():
    assert sorted(presets.names()) == sorted(path.stem for path in FILES)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_preset_is_found_by_its_name_in_any_folder(tmp_path, monkeypatch, path):
    expected = config.load(path)
    monkeypatch.chdir(tmp_path)
    found = config.load(path.stem)
    assert (found.run, found.agent, found.low, found.scenes) == (
        expected.run,
        expected.agent,
        expected.low,
        expected.scenes,
    )


def test_a_name_is_the_preset_also_beside_a_file_of_that_name_and_a_line_says_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scattered").write_text("seed: 7\n")
    lines = []
    assert config.load("scattered", notify=lines.append).run.name == "scattered"
    assert len(lines) == 1 and "./scattered" in lines[0]
    assert config.load("./scattered").seed == config.load(Path("scattered")).seed == 7


def test_a_preset_may_be_the_base_of_a_file(tmp_path):
    (tmp_path / "mine.yaml").write_text("base: scattered\nseed: 5\n")
    made = config.load(tmp_path / "mine.yaml")
    assert (made.seed, made.run) == (5, config.load("scattered").run)


def test_a_name_that_is_neither_preset_nor_file_is_answered_with_the_presets():
    with pytest.raises(ConfigError, match=r"configuration file scatered: No such file .*; allowed are .* scattered"):
        config.load("scatered")
