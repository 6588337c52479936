from pathlib import Path

import pytest

from zsdist.config import Config, dump, known_keys, load
from zsdist.errors import ConfigError
from zsdist.sim.scenes.manifest import MANIFEST

CONFIGS = Path(__file__).parents[2] / "configs"
PRESETS = sorted((*CONFIGS.glob("*.yaml"), *CONFIGS.glob("baselines/*.yaml")))


@pytest.mark.parametrize("path", PRESETS, ids=lambda path: path.stem)
def test_preset_loads_and_is_named_after_its_file(path):
    assert load(path).run.name == path.stem


def test_default_preset_spells_out_every_default():
    text = (CONFIGS / "default.yaml").read_text()
    settings = "".join(line for line in text.splitlines(keepends=True) if not line.startswith("#"))
    assert settings == dump(Config())


def test_paper_preset_holds_tables_1_and_2():
    paper = load(CONFIGS / "paper.yaml")
    stated = {
        "camera.size_px": 512,
        "high.learning_rate": 0.002,
        "low.learning_rate": 0.002,
        "agent.epsilon_decay": 0.995,
        "agent.epsilon_min": 0.1,
        "high.discount": 0.99,
        "low.discount": 0.99,
        "grid.blocks": 4,
        "grid.cells": 32,
        "reward.goal": 1000.0,
        "sim.max_steps": 500,
        "reward.collision": -200.0,
        "replay.grow_rate": 0.9,
        "replay.grow_threshold": 1.2,
        "replay.shrink_rate": 0.9,
        "replay.shrink_threshold": 1.0,
        "replay.size_initial": 10_000,
        "replay.batch_initial": 128,
        "replay.size_min": 1_000,
        "replay.size_max": 20_000,
        "replay.batch_min": 16,
        "replay.batch_max": 256,
    }
    assert set(stated) <= set(known_keys())
    for path, value in stated.items():
        section, name = path.split(".")
        assert getattr(getattr(paper, section), name) == value, path


def test_paper_preset_learns_the_literal_reward_by_plain_dqn():
    paper = load(CONFIGS / "paper.yaml")
    assert paper.reward.literal
    for level in (paper.high, paper.low):
        assert (level.double, level.huber, level.target_tau, level.guide_margin_weight) == (False, False, 0.0, 0.0)


def differences(one, other):
    return {
        f"{section}.{name}"
        for section, values in one.model_dump().items()
        if isinstance(values, dict)
        for name, value in values.items()
        if value != other.model_dump()[section][name]
    } - {"run.name"}


LEARNED_ALONE = {
    "agent.guide_share",
    "agent.shield_share",
    "high.guide_margin_weight",
    "low.guide_margin_weight",
    "replay.adaptive",
    "merge.every_episodes",
}


@pytest.mark.parametrize(
    ("name", "differing"),
    [
        ("flat-dqn", {"agent.high_policy"}),
        ("traditional-hrl", LEARNED_ALONE | {"vision.rays"}),
        ("hrl-vision", LEARNED_ALONE),
        ("no-merge", {"merge.every_episodes"}),
        ("fixed-replay", {"replay.adaptive"}),
        ("three-directions", {"vision.rays"}),
        ("no-contrast", {"vision.weights"}),
    ],
)
def test_a_baseline_differs_from_the_common_preset_in_its_own_settings(name, differing):
    base = load(CONFIGS / "scattered.yaml")
    assert differences(load(CONFIGS / "baselines" / f"{name}.yaml"), base) == differing


def test_baselines_train_on_the_training_families_only():
    for path in CONFIGS.glob("baselines/*.yaml"):
        assert set(load(path).scenes.train) <= set(MANIFEST["policy-training"].families)


def test_a_file_overrides_its_base(tmp_path):
    (tmp_path / "base.yaml").write_text("sim: {max_steps: 9, step_s: 0.1}\nscenes: {train: [iid]}\n")
    (tmp_path / "over.yaml").write_text("base: base.yaml\nsim: {max_steps: 7}\nseed: 3\n")
    config = load(tmp_path / "over.yaml", ("sim.success_radius_m=0.5",))
    assert (config.sim.max_steps, config.sim.step_s, config.sim.success_radius_m) == (7, 0.1, 0.5)
    assert (config.scenes.train, config.seed) == (("iid",), 3)


@pytest.mark.parametrize(("base", "words"), [("missing.yaml", "No such file"), ("over.yaml", "has a base too")])
def test_a_base_that_is_not_there_or_has_one_itself_is_refused(tmp_path, base, words):
    (tmp_path / "over.yaml").write_text(f"base: {base}\n")
    with pytest.raises(ConfigError, match=words):
        load(tmp_path / "over.yaml")
