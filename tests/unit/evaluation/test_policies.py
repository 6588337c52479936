import time

import numpy as np
from fakes import FakeVisualAct, LatticeEnv

from zsdist.evaluation.episodes import EpisodeRunner
from zsdist.evaluation.policies import find_policy
from zsdist.evaluation.workers import drive_all
from zsdist.sim.scenes import families


def test_the_shipped_policy_was_trained_for_the_networks_and_the_vision_of_this_package():
    policy = find_policy("pretrained")
    contender = policy.contender
    assert contender.config.scenes.train == ("iid",) and len(policy.weights_sha256) == 64
    env = LatticeEnv(config=contender.settings)
    driver = contender.driver(FakeVisualAct())
    record = EpisodeRunner(env, contender.settings, driver, contender.observability, time.monotonic).drive(
        families.draw("iid", "validation", 0), np.random.default_rng(0)
    )
    assert record.outcome == "success"


def test_a_baselines_world_may_be_configured(tmp_path):
    (tmp_path / "short.yaml").write_text("sim: {max_steps: 2}\n")
    policy = find_policy("astar", tmp_path / "short.yaml")
    assert policy.weights_sha256 is None
    records = drive_all(
        policy.contender,
        [families.draw("singleton", "test", 0)],
        seed=0,
        workers=1,
        on_record=lambda index, record: None,
    )
    assert records[0].steps == 2 and records[0].outcome == "timeout"
