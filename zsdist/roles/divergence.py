"""Range of a level's values, and the report where its learning has left that range.

A network has diverged if a number is not finite, or if its values are far beyond any return that the rewards allow.
The update that would do that is not made, and the learner goes back to its last sound state (`zsdist.roles.rollback`).
Such a network is never published and never saved. Where that happens again and again, the run ends with the cause.
"""

import math

from zsdist.config import Config, LevelConfig
from zsdist.errors import RunError
from zsdist.types import Level

BEYOND = 1000.0  # multiple of the largest possible return from which values count as diverged
SHAPED_REWARD = 10.0  # upper bound of the shaped rewards (`zsdist.agent.reward_shaping`)
_SUSPICIOUS = 5.0  # multiple of the default from which a setting is named as the likely cause
_FACTORS = ("learning_rate", "reward_scale", "guide_margin", "guide_margin_weight", "max_gradient_norm")
_REWARDS = ("goal", "collision", "safe", "step")


def settings_of(config: Config, level: Level) -> LevelConfig:
    """Return the section of a level."""
    return config.high if level is Level.HIGH else config.low


def value_limit(config: Config, level: Level) -> float:
    """Return the magnitude beyond which a value of this level's networks cannot be a return any more."""
    settings, reward = settings_of(config, level), config.reward
    largest = SHAPED_REWARD
    if reward.literal:
        largest = sum(abs(getattr(reward, name)) for name in _REWARDS) + 2 * config.grid.arena_m
    steps = config.sim.max_steps if settings.discount == 1 else min(1 / (1 - settings.discount), config.sim.max_steps)
    return BEYOND * (settings.reward_scale * largest * steps + settings.guide_margin)


def remedy(config: Config, level: Level) -> str:
    """Return the setting that most likely made a level diverge, and the override that changes it."""
    settings, reward = settings_of(config, level), config.reward
    usual = type(settings)()
    for name in _FACTORS:
        found, default = getattr(settings, name), getattr(usual, name)
        if found > _SUSPICIOUS * max(default, 1e-6):
            return _named(f"{level}.{name}", found, default, default)
    if reward.literal:
        for name in _REWARDS:
            found, default = getattr(reward, name), getattr(type(reward)(), name)
            if abs(found) > _SUSPICIOUS * max(abs(default), 1.0):
                return _named(f"reward.{name}", found, default, default)
    for name, advised in (("huber", True), ("double", True), ("discount", usual.discount)):
        found = getattr(settings, name)
        if found != advised and (name != "discount" or found > advised):
            return _named(f"{level}.{name}", found, advised, advised)
    rate = settings.learning_rate
    return _named(f"{level}.learning_rate", rate, usual.learning_rate, float(f"{rate / 10:.2g}"))


def diverged(config: Config, level: Level, updates: int, episodes: int, found: str) -> RunError:
    """Return the error that ends the run.

    Args:
        config: configuration of the run.
        level: level that diverged.
        updates: number of its updates so far.
        episodes: number of finished episodes of the run.
        found: what was found, with the value and what is allowed.
    """
    return RunError(
        f"the {level} level diverged at update {updates}, after {episodes} episodes: {found}; "
        f"{remedy(config, level)}; its last networks are not saved"
    )


def beyond(largest: float, limit: float) -> str:
    """Return what is wrong with the largest magnitude of an update that was refused."""
    if not math.isfinite(largest):
        return f"a value, error or gradient is {largest}"
    return f"a value of {largest:.3g} was computed; no return is beyond {limit / BEYOND:.3g}"


def _named(key: str, found: object, default: object, advised: object) -> str:
    told = f"{key} is {found}, by default {default}"
    return f"the likely setting: {told}; change it with --set {key}={_yaml(advised)}"


def _yaml(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
