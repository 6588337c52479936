"""Settings that are changed where a run is resumed: each takes effect from there on, or is refused by its name."""

from operator import attrgetter
from typing import Literal, get_args, get_origin

import numpy as np
import pytest

from zsdist import config
from zsdist.common import values
from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.run import directory
from zsdist.run.directory import RunDirectory
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire.messages import State

LEAVES = dict(values.leaves(Config))
COUNTED = {  # what is restored follows from them, so it is counted anew from the change on
    "high.updates_per_insert": "tests/unit/replay/test_limiter.py",
    "low.updates_per_insert": "tests/unit/replay/test_limiter.py",
    "replay.adjust_every_episodes": "tests/unit/replay/test_sizing.py",
    "replay.size_initial": "tests/unit/replay/test_sizing.py",
    "replay.batch_initial": "tests/unit/replay/test_sizing.py",
}
READ_AT_THE_START = """
placement run.name run.episodes run.actors run.cars_per_actor run.checkpoint_every_episodes run.cpus_per_role
run.checkpoint_every_s run.checkpoints_kept run.standby run.address run.final_evaluation_episodes
scenes.train scenes.train_scenes scenes.test
sim.step_s sim.max_steps sim.success_radius_m
camera.back_end camera.size_px camera.field_of_view_deg camera.range_m camera.height_m camera.forward_m
cluster.hubs cluster.KIND.node cluster.KIND.labels cluster.KIND.cpus cluster.KIND.gpus cluster.KIND.memory_bytes
vision.weights vision.encoder vision.network vision.rays vision.ray_quantile vision.cache_bytes vision.device
reward.goal reward.collision reward.safe reward.step reward.literal
agent.epsilon_decay agent.epsilon_min agent.guide_share agent.option_max_steps agent.shield_share agent.attraction
agent.repulsion agent.influence_m agent.trail agent.high_policy agent.low_policy agent.explored_share
LEVEL.learning_rate LEVEL.discount LEVEL.reward_scale LEVEL.double LEVEL.huber LEVEL.target_tau
LEVEL.max_gradient_norm LEVEL.guide_margin LEVEL.guide_margin_weight LEVEL.min_size
replay.shards replay.fsync_ms replay.journals replay.n_step replay.prioritised replay.priority_exponent
replay.importance_exponent replay.adaptive
replay.size_min replay.size_max replay.batch_min replay.batch_max replay.grow_rate replay.grow_threshold
replay.shrink_rate replay.shrink_threshold replay.average_episodes replay.target_return replay.max_bytes
merge.every_episodes merge.validation_scenes merge.drive_steps merge.distil_updates merge.drop_after_scenes
merge.share
transport.kind transport.endpoint transport.tls transport.mailbox_bytes transport.window_frames
transport.resend_after_s transport.give_up_after_s
"""  # by the role that uses it; no state that is restored contains it or follows from it
PLACED = ("learner", "replay", "actor")
READ = {
    key.replace("LEVEL", level).replace("KIND", kind)
    for key in READ_AT_THE_START.split()
    for level in ("high", "low")
    for kind in PLACED
}
TOGETHER = {  # settings that are changed with another one, without which they would not be allowed
    "placement": ("transport.kind=memory",),
    "transport.kind": ("placement=inline",),
    "run.address": ("transport.tls=/made", "transport.endpoint=tls/h:1"),
    "transport.tls": ("transport.endpoint=tls/h:1",),
    "cluster.replay.node": ("replay.journals=/made",),
    "cluster.learner.labels": ("cluster.learner.node=any",),
    "cluster.replay.labels": ("cluster.replay.node=any", "replay.journals=/made"),
}
OTHER = {
    "replay.fsync_ms": "5",
    "run.address": "h:1",
    "transport.endpoint": "tcp/127.0.0.1:1",
    "scenes.train": "[iid]",
    "run.actors": "9",
    "cluster.hubs": "[tls/h:1@rack=a]",
    **{f"cluster.{kind}.labels": "rack=a" for kind in PLACED},
    **{f"cluster.{kind}.cpus": "2" for kind in PLACED},
}


def other_value(key):
    """Return a text of another value that a setting may have."""
    annotation, now = LEAVES[key], attrgetter(key)(Config())
    while get_args(annotation) and get_origin(annotation) is not Literal and hasattr(annotation, "__metadata__"):
        annotation = get_args(annotation)[0]
    if key in OTHER:
        return OTHER[key]
    if get_origin(annotation) is Literal:
        return next(name for name in get_args(annotation) if name != now)
    if isinstance(now, bool):
        return str(not now)
    if isinstance(now, int | float):
        nearby = [now + 1, now - 1, now * 2, now / 2, now / 2 + 0.4]
        return next(str(value) for value in nearby if allowed(f"{key}={value}"))
    return (
        "[5]" if isinstance(now, tuple) and key.endswith("hidden") else "[/made]" if isinstance(now, tuple) else "made"
    )


def allowed(override):
    try:
        return config.load(None, (override,)) != Config()
    except config.ConfigError:
        return False


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = directory.create(tmp_path_factory.mktemp("run") / "run", Config())
    states = {
        "scheduler": State("scheduler", {"finished": [1, 2], "wall_s": 3.0}, {}),
        "replay": State("replay", {}, {"ring": np.zeros(3)}),
    }
    RunDirectory(folder, VisionIdentity("clip/b", "a" * 64, "head", "b" * 64)).checkpoint(2, states)
    return folder


def test_every_setting_is_known_as_fixed_as_counted_anew_or_as_read_at_the_start():
    assert set(directory.FIXED) | set(COUNTED) | READ == set(LEAVES)
    assert len(directory.FIXED) + len(COUNTED) + len(READ) == len(LEAVES)


@pytest.mark.parametrize("key", LEAVES)
def test_every_setting_takes_effect_or_is_refused_by_its_name(run, key):
    before = (run / "config.yaml").read_bytes()
    overrides = (f"{key}={other_value(key)}", *TOGETHER.get(key, ()))
    if key in directory.FIXED:
        with pytest.raises(RunError, match=rf"{key} is .*; allowed is the run's original value"):
            directory.reopen(run, overrides)
    else:
        settings, _ = directory.reopen(run, overrides)
        assert attrgetter(key)(settings) != attrgetter(key)(Config())
    assert (run / "config.yaml").read_bytes() == before
