"""Plan of a sweep, from a YAML file: variants of the settings, seeds, and the evaluation that compares them."""

import itertools
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from zsdist import config
from zsdist.common import presets, strict_yaml
from zsdist.common.section import Section
from zsdist.config import Config
from zsdist.errors import ConfigError

WHOLE = "base"  # name of the only variant of a file that names none
_NAME = re.compile(r"[A-Za-z0-9._-]{1,100}")
_UNSAFE = re.compile(r"[^A-Za-z0-9._]+")
Number = Annotated[int, Field(ge=0, lt=2**31)]
Count = Annotated[int, Field(ge=1)]


class SweepEvaluation(Section):
    """Evaluation of each trial; all drive the same scenes."""

    scenes: Annotated[str, Field(min_length=1)] = "test"  # as `zsdist evaluate --scenes` takes them
    episodes: Count = 50
    seed: Number = 0


class SweepPlan(Section):
    """Content of a sweep's file."""

    base: Annotated[str, Field(min_length=1)] = "default"  # preset, or path of a configuration beside the file
    seeds: Annotated[tuple[Number, ...], Field(min_length=1)] = (0, 1, 2)
    episodes: Count | None = None  # training episodes of a trial; None: those of the base
    single_process: bool = True  # whether a trial is one process; else roles have processes of their own
    trials_at_once: Count | None = None  # None: as many as there are cores for
    cores_per_trial: Count = 1
    variants: dict[str, Any] = Field(default_factory=dict)  # settings to change, by the variant's name
    grid: dict[str, Any] = Field(default_factory=dict)  # values of a setting, by its path; all are combined
    evaluation: SweepEvaluation = SweepEvaluation()


@dataclass(frozen=True)
class SweepTrial:
    """One training of a sweep.

    Attributes:
        variant: name of the variant, which can be part of the name of a file.
        title: the same as people read it.
        seed: seed of the training.
        settings: configuration of the training.
    """

    variant: str
    title: str
    seed: int
    settings: Config

    @property
    def name(self) -> str:
        """Name of the trial, and of its run directory."""
        return f"{self.variant}-seed-{self.seed}"


def read(file: Path) -> tuple[SweepPlan, list[SweepTrial]]:
    """Return the plan in a file and its trials, seed by seed, so that an early table compares all variants.

    Raises:
        ConfigError: the file cannot be read, or a key or a value in it is wrong, also of a configuration's settings.
    """
    plan = _read_plan(file)
    base: str | Path = plan.base if presets.find(plan.base) else file.absolute().parent / Path(plan.base).expanduser()
    variants = list(_variants(file, plan))
    trials = []
    for seed in dict.fromkeys(plan.seeds):
        for name, title, overrides in variants:
            changes = (*_common(plan), *overrides, f"run.name={name}", f"seed={seed}")
            try:
                trials.append(SweepTrial(name, title, seed, config.load(base, changes)))
            except ConfigError as error:
                raise ConfigError(f"sweep file {file}, variant {title}: {error}") from error
    return plan, trials


def _read_plan(file: Path) -> SweepPlan:
    tree = strict_yaml.read(file, "sweep file")
    if not isinstance(tree, dict):
        raise ConfigError(
            f"sweep file {file} holds no mapping; allowed are the keys {', '.join(SweepPlan.model_fields)}"
        )
    try:
        return SweepPlan.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"sweep file {file}: {'; '.join(_explain(dict(item)) for item in error.errors())}") from error


def _explain(item: dict[str, Any]) -> str:
    key = ".".join(str(part) for part in item["loc"])
    if item["type"] == "extra_forbidden":
        fields = SweepEvaluation.model_fields if key.startswith("evaluation.") else SweepPlan.model_fields
        hint = "; a setting belongs under variants or grid" if key.partition(".")[0] in Config.model_fields else ""
        return f"unknown key {key!r}; allowed are {', '.join(fields)}{hint}"
    return f"{key} is {item['input']!r}: {item['msg'].removeprefix('Value error, ')}"


def _common(plan: SweepPlan) -> Iterator[str]:
    """Yield the settings that all trials have; a variant may set them differently."""
    yield "run.final_evaluation_episodes=0"  # the sweep's own evaluation compares them
    if plan.episodes is not None:
        yield f"run.episodes={plan.episodes}"
    if plan.single_process:
        yield from config.ONE_PROCESS


def _variants(file: Path, plan: SweepPlan) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield name, title and overrides of each variant: every named one at every point of the grid."""
    named: dict[str, tuple[str, ...]] = {}
    for name, settings in plan.variants.items():
        if not _NAME.fullmatch(name):
            raise ConfigError(
                f"sweep file {file}: variant {name!r}; allowed are up to 100 letters, digits and the signs . _ -"
            )
        if isinstance(settings, strict_yaml.Plain) and not settings.strip():
            settings = {}  # the base as it is
        if not isinstance(settings, dict):
            raise ConfigError(f"sweep file {file}: variants.{name} is {settings!r}; allowed is a mapping of settings")
        named[name] = tuple(f"{key}={_text(value)}" for key, value in settings.items())
    axes = []
    for key, values in plan.grid.items():
        if not isinstance(values, list) or not values:
            raise ConfigError(f"sweep file {file}: grid.{key} is {values!r}; allowed is a list of values")
        axes.append([f"{key}={_text(value)}" for value in values])
    found: set[str] = set()
    for name, *point in itertools.product(named or {"": ()}, *axes):
        title = ", ".join(part for part in (name, *point) if part) or WHOLE
        short = _UNSAFE.sub("-", title).strip("-")[:100]
        if short in found:
            raise ConfigError(f"sweep file {file}: variant {title} is there twice, or its name is too long; rename it")
        found.add(short)
        yield short, title, (*named.get(name, ()), *point)


def _text(value: Any) -> str:
    """Return a value of the file as `--set` takes it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_text(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_text, value)) + "]"
    return str(value) if isinstance(value, strict_yaml.Plain) else json.dumps(value, ensure_ascii=False)
