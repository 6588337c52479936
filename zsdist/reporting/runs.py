"""Material of a report: run directories and evaluations, read and grouped into methods."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from zsdist import config
from zsdist.common import folders, random_streams
from zsdist.config import Config
from zsdist.errors import ConfigError, RunError
from zsdist.evaluation import episode_store
from zsdist.evaluation.contenders import FULL
from zsdist.evaluation.fingerprint import equivalent
from zsdist.evaluation.metrics import summarise_scenes
from zsdist.run import location
from zsdist.types import Level

Row = dict[str, Any]
_EVALUATED = {"policy", "weights_sha256", "scenes", "episodes", "success", "collision", "timeout", "confidence_95"}
_FINISHED = {"finished_as", "outcome", "return", "steps"}
_SUMMARY = {"ended", "env_steps", "merges", "wall_s", "weights"}
_NOT_SEARCHED = {"checkpoints", "tensorboard", "logs", "figures"}  # names of folders without evaluations
_RUN_FILES = {"summary.json", "metrics.jsonl", "episodes.jsonl"}
# Episodes that agree in these fields belong to one evaluation.
_EVALUATION_KEY = ("policy", "variant", "shielded", "scenes", "seed", "weights_sha256")
NO_SHIELD = "no shield"
_OF_ONE_RUN = ("seed", "run.", "placement", "transport.")  # settings that may differ between the runs of a method


@dataclass(frozen=True)
class Evaluation:
    """Result of one evaluation, with the method that it belongs to.

    Attributes:
        result: JSON object as `zsdist.evaluate --json` writes it.
        label: name of the driver in tables: a method, with its variant if any, or a baseline.
        method: method whose networks drove; None for a baseline, and for a policy whose run is not among those given.
        seed: seed of their training; None as for `method`.
    """

    result: Row
    label: str
    method: str | None = None
    seed: int | None = None

    @property
    def scenes(self) -> str:
        """Scenes that were driven."""
        return str(self.result["scenes"])

    @property
    def variant(self) -> str:
        """Part replaced in a learned policy: a name of `zsdist.evaluate --variant`, or the shield."""
        variant = str(self.result.get("variant", FULL))
        if self.result.get("shielded", True):
            return variant
        return NO_SHIELD if variant == FULL else f"{variant}, {NO_SHIELD}"


@dataclass(frozen=True)
class Run:
    """One training run.

    Attributes:
        folder: run directory.
        settings: configuration of the run.
        episodes: lines of `episodes.jsonl`, in the order in which they finished.
        metrics: lines of `metrics.jsonl`.
        summary: `summary.json`; None while the run continues, or where it failed.
    """

    folder: Path
    settings: Config
    episodes: Sequence[Row] = field(repr=False)
    metrics: Sequence[Row] = field(repr=False)
    summary: Row | None = field(repr=False)

    @property
    def weights_sha256(self) -> str | None:
        """Hash of both networks at its end, as in evaluations; None before the end."""
        if self.summary is None:
            return None
        hashes = self.summary["weights"]["sha256"]
        return hashlib.sha256("".join(hashes[level] for level in Level).encode()).hexdigest()

    @property
    def merges(self) -> Sequence[Row]:
        """Merges of the run, from its summary."""
        return self.summary["merges"] if self.summary else []

    @property
    def method(self) -> str:
        """Name of its configuration, which stands for its method."""
        return self.settings.run.name


@dataclass(frozen=True)
class Method:
    """The runs of one configuration under different seeds.

    Attributes:
        name: name of the configuration.
        runs: one or more runs, ordered by seed.
        differing: settings in which the runs differ, other than the seed and the settings of the machine.
    """

    name: str
    runs: Sequence[Run]
    differing: Sequence[str]


@dataclass(frozen=True)
class Material:
    """All runs, by method, and all evaluations of a report."""

    methods: Sequence[Method]
    evaluations: Sequence[Evaluation]

    @property
    def runs(self) -> list[Run]:
        """Runs of all methods."""
        return [run for method in self.methods for run in method.runs]


def read(places: Sequence[Path]) -> Material:
    """Read run directories, and files or folders of evaluations.

    Raises:
        RunError: a path does not exist or holds neither, or a file in it is damaged.
    """
    runs: list[Run] = []
    found: list[tuple[Row, Run | None]] = []
    for place in dict.fromkeys(path.resolve() for path in places):
        home = read_run(place) if (place / "config.yaml").is_file() else None
        results = list(_results(place)) if place.exists() else []
        if home is None and not results and (run := location.find_run(place)) != place:
            home, results = read_run(run), list(_results(run))  # the path of something inside a run
        if home is not None:
            runs.append(home)
        elif not results:
            raise RunError(
                f"{place} holds neither a run nor an evaluation; allowed are run directories, files that "
                "zsdist.evaluate --json or --out wrote, and folders of these"
            )
        found += [(result, home) for result in results]
    return Material(_methods(runs), [_evaluation(result, home, runs) for result, home in found])


def read_run(folder: Path) -> Run:
    """Return the run in a run directory; raise `RunError` where it is damaged."""
    try:
        settings = config.load(folder / "config.yaml")
    except ConfigError as error:
        raise RunError(f"run directory {folder}: {error}") from error
    episodes = _lines(folder / "episodes.jsonl")
    if any(not set(episode) >= _FINISHED for episode in episodes):
        raise RunError(f"{folder / 'episodes.jsonl'} has a line that lacks one of {', '.join(sorted(_FINISHED))}")
    summary = _json(folder / "summary.json") if (folder / "summary.json").exists() else None
    if summary is not None and not (isinstance(summary, dict) and set(summary) >= _SUMMARY):
        raise RunError(f"{folder / 'summary.json'} is no summary of a run: it needs {', '.join(sorted(_SUMMARY))}")
    in_order = sorted(episodes, key=lambda episode: episode["finished_as"])
    return Run(folder, settings, in_order, _lines(folder / "metrics.jsonl"), summary)


def _methods(runs: Sequence[Run]) -> list[Method]:
    methods = []
    for name in dict.fromkeys(run.method for run in runs):
        seeds = sorted((run for run in runs if run.method == name), key=lambda run: run.settings.seed)
        trees = [_flat(run.settings.model_dump(mode="json")) for run in seeds]
        differing = [
            key
            for key in trees[0]
            if not key.startswith(_OF_ONE_RUN) and any(tree.get(key) != trees[0][key] for tree in trees)
        ]
        methods.append(Method(name, seeds, differing))
    return methods


def _flat(tree: Row, prefix: str = "") -> Row:
    flat: Row = {}
    for key, value in tree.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return flat


def _evaluation(result: Row, home: Run | None, runs: Sequence[Run]) -> Evaluation:
    """Return an evaluation with its owner: the run that ended with its weights, else the run whose folder holds it."""
    sha256, name = result["weights_sha256"], Path(str(result.get("run", result["policy"]))).name
    if sha256 is None:
        return Evaluation(result, name)
    owner = next((run for run in runs if run.weights_sha256 == sha256), None)
    if owner is not None:
        evaluation = Evaluation(result, owner.method, owner.method, owner.settings.seed)
    elif home is not None:
        evaluation = Evaluation(result, f"{home.method}, {name}", home.method, home.settings.seed)
    else:
        evaluation = Evaluation(result, name)
    if evaluation.variant == FULL:
        return evaluation
    return replace(evaluation, label=f"{evaluation.label}, {evaluation.variant}")


def _results(place: Path) -> Iterator[Row]:
    """Yield the results of evaluations in a file or under a folder; a JSON of several runs yields one for each run."""
    found = (path for path in (folders.visible(place, "**/*.json*")) if path.suffix in (".json", ".jsonl"))
    files = [place] if place.is_file() else [path for path in found if path.is_file()]
    for file in files:
        inside = file.relative_to(place).parts
        if _NOT_SEARCHED & set(inside) or (len(inside) == 1 and file.name in _RUN_FILES):
            continue
        content = _json(file) if file.suffix == ".json" else _summarise_episodes(file)
        for one in content if isinstance(content, list) else [content]:
            several = one.get("runs", [one]) if isinstance(one, dict) else []
            for result in several if isinstance(several, list) else []:
                if isinstance(result, dict) and set(result) >= _EVALUATED:
                    yield from _split_by_shield(result)


def _split_by_shield(result: Row) -> Iterator[Row]:
    """Yield a result, and where it has figures without the shield, these as a result of their own."""
    yield result
    if bare := result.get("without_shield"):
        kept = {key: result[key] for key in ("policy", "weights_sha256", "scenes", "episodes", "seed")}
        about = {key: result[key] for key in ("run", "variant") if key in result}
        yield kept | about | bare | {"shielded": False, "confidence_95": {"success": bare["success_95"]}}


def _summarise_episodes(file: Path) -> list[Row]:
    """Return the results of the evaluations in a file of `zsdist.evaluate --out`, of the newest code of each."""
    if not any('"scene_hash"' in line for line in _text(file).splitlines()[:1]):
        return []
    lines = episode_store.read(file)
    groups: dict[tuple[Any, ...], dict[int, episode_store.Line]] = {}
    for line in lines:
        key = tuple(line.about[name] for name in _EVALUATION_KEY)
        groups.setdefault(key, {})
        codes = equivalent(line.about["code"])
        if any(other.about["code"] not in codes for other in groups[key].values()):
            groups[key] = {}
        groups[key][line.about["index"]] = line
    results = []
    for key, by_index in groups.items():
        about = dict(zip(_EVALUATION_KEY, key, strict=True))
        lines_of_it = [by_index[index] for index in sorted(by_index)]
        records, scenes = [line.record for line in lines_of_it], [line.about["scene_hash"] for line in lines_of_it]
        summary = summarise_scenes(records, scenes, random_streams.intervals(about["seed"]))
        results.append(about | {"run": about["policy"], "episodes": len(records)} | summary)
    return results


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RunError(f"{file} cannot be read: {error}") from error


def _json(file: Path) -> Any:
    try:
        return json.loads(_text(file))
    except (ValueError, RecursionError) as error:
        raise RunError(f"{file} cannot be read as JSON: {error}") from error


def _lines(file: Path) -> list[Row]:
    """Return the objects of a JSON Lines file; an unfinished last line is left out, any other bad line is an error."""
    if not file.exists():
        return []
    text = _text(file)
    whole = text[: text.rfind("\n") + 1].splitlines()
    try:
        rows = [json.loads(line) for line in whole]
    except (ValueError, RecursionError) as error:
        raise RunError(f"{file} has a line that is no JSON: {error}") from error
    if not all(isinstance(row, dict) for row in rows):
        raise RunError(f"{file} has a line that is no JSON object; allowed is one object a line")
    return rows
