"""Numbers of the configuration: within their range nothing that is sent can overflow; beyond it they are refused."""

import pytest
from pydantic import BaseModel

from zsdist.config import Config, load, parse
from zsdist.errors import ConfigError
from zsdist.roles import schemas
from zsdist.wire.messages import EPISODES

HARMLESS = {  # floats that reach no message, or only choose among what is computed
    "low.max_gradient_norm",
    "high.max_gradient_norm",
    "replay.grow_threshold",
    "replay.shrink_threshold",
    "replay.target_return",
    "transport.resend_after_s",
    "transport.give_up_after_s",
    "run.cpus_per_role",
}


def floats(model=Config, prefix=""):
    """Yield the keys of all settings that are floats."""
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from floats(field.annotation, f"{prefix}{name}.")
        elif field.annotation is float:
            yield prefix + name


@pytest.mark.parametrize("key", sorted(set(floats()) - HARMLESS))
def test_every_float_setting_has_a_range(key):
    for value in ("1.0e+30", "-1.0e+30"):
        with pytest.raises(ConfigError, match=key):
            load(None, (f"{key}={value}",))


@pytest.mark.parametrize("key", ["low.hidden=[9000,9000]", "sim.max_steps=70000", "merge.validation_scenes=30000"])
def test_counts_whose_messages_would_be_refused_are_refused_first(key):
    with pytest.raises(ConfigError, match=key.partition("=")[0]):
        load(None, (key,))


def test_the_record_of_the_longest_and_richest_episode_is_accepted():
    config = parse({"reward": {"goal": 1e6, "step": 1e6, "safe": 1e6, "collision": 1e6}, "sim": {"max_steps": 10_000}})
    reward, steps = config.reward, config.sim.max_steps
    total = steps * (reward.goal + reward.safe)
    record = {
        "actor": "actor-0",
        "episode": 1,
        "scene": "made up",
        "outcome": "timeout",
        "steps": steps,
        "return": total,
        "epsilon": 0.5,
        "shielded": True,
        "path_m": 1e3 * steps,
        "start": [0.0, 0.0],
        "goal": [1.0, 1.0],
        "path": [[0.0, 0.0]] * (steps + 1),
    }
    assert schemas.check_record(EPISODES, record).total == total
