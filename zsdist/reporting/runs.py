"""What a report is made from: run directories and the evaluations found in them, read and grouped into methods."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from zsdist import config
from zsdist.config import Config
from zsdist.errors import RunError

Row = dict[str, Any]
_EVALUATED = {"policy", "weights_sha256", "scenes", "episodes", "success", "collision", "timeout", "confidence_95"}
_NO_EVALUATIONS = {"checkpoints", "tensorboard", "logs", "figures"}  # folders that are not searched
_OF_ONE_RUN = ("seed", "run.", "placement", "transport.")  # settings that may differ between the runs of a method


@dataclass(frozen=True)
class Evaluation:
    """One evaluation's JSON with whose it is: `method` and training `seed`, both None of a baseline on its own."""

    result: Row
    method: str | None = None
    seed: int | None = None

    @property
    def label(self) -> str:
        """Who drove, as tables name it: the method for what it trained, else the policy's own name."""
        policy = str(self.result["policy"])
        if self.result["weights_sha256"] is None:
            return policy
        if self.method is None:
            return Path(policy).name
        return f"{self.method}, untrained" if policy == "untrained" else self.method


@dataclass(frozen=True)
class Run:
    """One training.

    Attributes:
        folder: of the run.
        settings: its configuration.
        episodes: lines of `episodes.jsonl`, in the order in which they finished.
        metrics: lines of `metrics.jsonl`.
        summary: `summary.json`; None while it goes on, or where it ended badly.
        evaluations: found in its folder.
    """

    folder: Path
    settings: Config
    episodes: Sequence[Row] = field(repr=False)
    metrics: Sequence[Row] = field(repr=False)
    summary: Row | None = field(repr=False)
    evaluations: Sequence[Evaluation] = field(repr=False)

    @property
    def method(self) -> str:
        """Name of its configuration."""
        return self.settings.run.name


@dataclass(frozen=True)
class Method:
    """The runs of one configuration under different seeds.

    Attributes:
        name: of the configuration.
        runs: at least one, by seed.
        differing: settings, seed and machine apart, in which the runs differ all the same.
    """

    name: str
    runs: Sequence[Run]
    differing: Sequence[str]


@dataclass(frozen=True)
class Material:
    """Everything a report is made from."""

    methods: Sequence[Method]
    evaluations: Sequence[Evaluation]

    @property
    def runs(self) -> list[Run]:
        """Of all methods."""
        return [run for method in self.methods for run in method.runs]


def read(places: Sequence[Path]) -> Material:
    """Reads run directories, and folders or files with nothing but evaluations.

    Raises:
        RunError: a place is not there, holds neither, or a file in it is damaged.
    """
    runs, evaluations = [], []
    for place in dict.fromkeys(place.resolve() for place in places):
        if (place / "config.yaml").is_file():
            runs.append(read_run(place))
            evaluations += runs[-1].evaluations
            continue
        found = list(_evaluations(place, None, None)) if place.exists() else []
        if not found:
            raise RunError(
                f"{place} holds neither a run nor an evaluation; allowed are run directories, files that "
                "zsdist.evaluate --json wrote, and folders of these"
            )
        evaluations += found
    return Material(_methods(runs), evaluations)


def read_run(folder: Path) -> Run:
    """One run directory; raises `RunError` or `ConfigError` where it is damaged."""
    settings = config.load(folder / "config.yaml")
    episodes = _lines(folder / "episodes.jsonl")
    summary = _json(folder / "summary.json") if (folder / "summary.json").exists() else None
    return Run(
        folder,
        settings,
        sorted(episodes, key=lambda episode: episode["finished_as"]),
        _lines(folder / "metrics.jsonl"),
        summary,
        list(_evaluations(folder, settings.run.name, settings.seed)),
    )


def _methods(runs: Sequence[Run]) -> list[Method]:
    methods = []
    for name in dict.fromkeys(run.method for run in runs):
        of_it = sorted((run for run in runs if run.method == name), key=lambda run: run.settings.seed)
        trees = [_flat(run.settings.model_dump(mode="json")) for run in of_it]
        differing = [
            key
            for key in trees[0]
            if not key.startswith(_OF_ONE_RUN) and any(tree.get(key) != trees[0][key] for tree in trees)
        ]
        methods.append(Method(name, of_it, differing))
    return methods


def _flat(tree: Row, prefix: str = "") -> Row:
    flat = {}
    for key, value in tree.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return flat


def _evaluations(place: Path, method: str | None, seed: int | None) -> Iterator[Evaluation]:
    files = [place] if place.is_file() else sorted(place.rglob("*.json"))
    for file in files:
        if file.name == "summary.json" or _NO_EVALUATIONS & set(file.relative_to(place).parts):
            continue
        found = _json(file)
        for result in found if isinstance(found, list) else [found]:
            if isinstance(result, dict) and set(result) >= _EVALUATED:
                yield Evaluation(result, method, seed)


def _json(file: Path) -> Any:
    try:
        return json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise RunError(f"{file} cannot be read as JSON: {error}") from error


def _lines(file: Path) -> list[Row]:
    """Objects of a JSON Lines file; a last line that was not finished is left out, any other is an error."""
    if not file.exists():
        return []
    text = file.read_text()
    whole = text[: text.rfind("\n") + 1].splitlines()
    try:
        return [json.loads(line) for line in whole]
    except ValueError as error:
        raise RunError(f"{file} has a line that is no JSON: {error}") from error
