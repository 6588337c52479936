from pathlib import Path

import pytest

from zsdist.config import Config, dump, known_keys, load

CONFIGS = Path(__file__).parents[2] / "configs"
PRESETS = sorted(CONFIGS.glob("*.yaml"))


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
