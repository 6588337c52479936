"""Whole evaluations: selection and driving of scenes with a progress display, and summaries as JSON and tables."""

import contextlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from zsdist.common import random_streams
from zsdist.common.console import PlainConsole, say, table
from zsdist.common.progress import StepProgress
from zsdist.evaluation.contenders import FULL, Contender
from zsdist.evaluation.episode_store import EpisodeStore
from zsdist.evaluation.fingerprint import code_sha256
from zsdist.evaluation.metrics import spl, summarise_scenes
from zsdist.evaluation.records import EpisodeRecord
from zsdist.evaluation.selection import select
from zsdist.evaluation.statistics import runs_95
from zsdist.evaluation.workers import EvaluationDrive, drive_all, drive_each
from zsdist.sim.scenes.families import FAMILIES
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Outcome

LABELS = {
    "success": "success",
    "collision": "collision",
    "timeout": "timeout",
    "spl": "SPL",
    "soft_spl": "SoftSPL",
    "path_efficiency": "path efficiency",
    "step_efficiency": "step efficiency",
    "min_clearance_m": "least clearance (m)",
}


@dataclass(frozen=True)
class Report:
    """Result of one evaluation.

    Attributes:
        contender: contender that was evaluated.
        result: figures as a JSON object.
        records: episodes, with their paths.
        scenes: hash of the scene of each episode.
    """

    contender: Contender
    result: dict[str, Any]
    records: Sequence[EpisodeRecord] = field(repr=False)
    scenes: Sequence[str] = field(repr=False)

    def beside(self, bare: "Report") -> "Report":
        """Return this report with figures of `bare` added, which has the same policy and scenes without the shield."""
        figures = {name: bare.result[name] for name in ("success", "collision", "timeout", "spl")}
        interval = bare.result["confidence_95"]["success"]
        return replace(self, result=self.result | {"without_shield": figures | {"success_95": interval}})

    def show(self, console: PlainConsole) -> None:
        """Print the figures with the circumstances they were measured under."""
        result, settings = self.result, self.contender.config.sim
        rows = []
        for name, label in LABELS.items():
            value, interval = result[name], result["confidence_95"].get(name)
            rows.append(
                [
                    label,
                    _figure(value),
                    f"{interval[0]:.3f} to {interval[1]:.3f}" if interval else "-",
                ]
            )
        if bare := result.get("without_shield"):
            low, high = bare["success_95"]
            rows.append(["success without the shield", f"{bare['success']:.3f}", f"{low:.3f} to {high:.3f}"])
        decision = result["decision_ms"]
        times = [_figure(decision[name], 1) for name in ("p50", "p99")]
        rows.append(["decision (ms), p50 / p99", " / ".join(times), "-"])
        console.say(f"{result['policy']} on {result['scenes']}")
        console.print(table(("figure", "value", "95%"), rows))
        decisions = sum(record.steps for record in self.records)
        changed = sum(record.shield_changes for record in self.records)
        number, scenes = result["episodes"], result.get("distinct_scenes", result["episodes"])
        repeated = "" if scenes == number else f" ({scenes} scenes, repeated; the intervals count each once)"
        known = sum(record.shortest_m is not None for record in self.records)
        notes = [
            f"n {number}{repeated}, seed {result['seed']}, success within {settings.success_radius_m} m, at most "
            f"{settings.max_steps} actions; observes {self.contender.observability}; "
            f"shield changed {changed} of {decisions} actions ({result['shield_changed_share']:.1%}). "
            f"Code {result['code_sha256']}."
        ]
        if not self.contender.baseline:
            trained = ", ".join(self.contender.config.scenes.train)
            notes.append(f"Weights {result['weights_sha256'][:16]}; scenes.train is {trained}.")
        if known < len(self.records):
            notes.append(f"SPL and the efficiencies are of the {known} episodes in whose scene a free path is known.")
        for note in notes:
            console.say(note)


@dataclass(frozen=True)
class Trial:
    """One evaluation of several: a contender and the scenes that it drives.

    Attributes:
        name: name of the policy.
        contender: contender that drives.
        sha256: hash of its networks; None for a baseline.
        scenes: folder, family or split, as `selection.select` accepts them.
        episodes: number of scenes.
        lasts: whether most of its drives may last to the limit of actions; such drives begin first, so that in the end
            no process waits for another.
    """

    name: str
    contender: Contender
    sha256: str | None
    scenes: str
    episodes: int
    lasts: bool = False


def evaluate_all(trials: Sequence[Trial], *, seed: int, workers: int) -> list[Report]:
    """Drive several evaluations in the same processes, with one display of progress, and return their reports in order.

    Args:
        trials: the evaluations.
        seed: seed of scenes and drivers.
        workers: number of processes.
    """
    scenes = [select(trial.scenes, trial.contender.config, trial.episodes, seed) for trial in trials]
    order = sorted(range(len(trials)), key=lambda number: not trials[number].lasts)
    drives = [EvaluationDrive(number, index, scene) for number in order for index, scene in enumerate(scenes[number])]
    records: list[dict[int, EpisodeRecord]] = [{} for _ in trials]
    contenders = [trial.contender for trial in trials]
    ended: Counter[Outcome] = Counter()
    with (
        StepProgress("evaluation", len(drives)) as progress,
        contextlib.closing(drive_each(contenders, drives, seed, workers)) as driven,
    ):
        for drive, record in driven:
            records[drive.contender][drive.number] = record
            ended[record.outcome] += 1
            trial = trials[drive.contender]
            progress.step(f"{trial.name} on {trial.scenes}; {_counts(ended)}")
    return [
        _report(trial.contender, trial.name, trial.sha256, trial.scenes, seed, chosen, [of[i] for i in range(len(of))])
        for trial, chosen, of in zip(trials, scenes, records, strict=True)
    ]


def evaluate(
    contender: Contender,
    *,
    policy: str,
    weights_sha256: str | None,
    scenes: str,
    episodes: int | None,
    seed: int,
    workers: int,
    out: Path | None = None,
) -> Report:
    """Drive the episodes with progress on the standard error stream, and return the report.

    Args:
        contender: contender to evaluate.
        policy: name that was requested. The result calls a variant by its own name and has this one as `run`.
        weights_sha256: hash of its networks; None for a baseline.
        scenes: folder, family or split, as `selection.select` accepts them.
        episodes: number of episodes; None: every file of a folder, else 50.
        seed: seed of scenes and drivers.
        workers: number of processes.
        out: file of an `EpisodeStore`; episodes that are in it are not driven again.
    """
    chosen, store = select(scenes, contender.config, episodes, seed), None
    known: Mapping[int, EpisodeRecord] = {}
    if out is not None:
        store = EpisodeStore(out, contender, policy, weights_sha256, scenes, seed, chosen)
        known = store.known
        if store.stale:
            say(f"{out}: {store.stale} episodes of other code, weights or settings are left out", error=True)
        if known:
            say(f"{out}: {len(known)} of {len(chosen)} episodes are there already", error=True)
    name = policy if contender.variant == FULL else contender.variant
    ended = Counter(record.outcome for record in known.values())
    with StepProgress(name, len(chosen), len(known)) as progress:

        def on_record(index: int, record: EpisodeRecord) -> None:
            if store is not None:
                store.add(index, record)
            ended[record.outcome] += 1
            progress.step(_counts(ended))

        records = drive_all(contender, chosen, seed, workers, on_record, known)
    return _report(contender, policy, weights_sha256, scenes, seed, chosen, records)


def _counts(ended: Counter[Outcome]) -> str:
    return ", ".join(f"{outcome} {ended[outcome]}" for outcome in Outcome)


def _report(
    contender: Contender,
    policy: str,
    weights_sha256: str | None,
    scenes: str,
    seed: int,
    chosen: Sequence[Scene],
    records: Sequence[EpisodeRecord],
) -> Report:
    about = {
        "policy": policy if contender.variant == FULL else contender.variant,
        "weights_sha256": weights_sha256,
        "scenes": scenes,
        "episodes": len(records),
        "seed": seed,
    }
    sim = contender.config.sim
    circumstances = {
        "run": policy,
        "variant": contender.variant,
        "shielded": contender.shielded,
        "success_radius_m": sim.success_radius_m,
        "max_steps": sim.max_steps,
        "code_sha256": code_sha256(),
    }
    hashes = [scene.hash() for scene in chosen]
    figures = summarise_scenes(records, hashes, random_streams.intervals(seed))
    return Report(contender, about | figures | circumstances, records, hashes)


def together(reports: Sequence[Report], seed: int) -> dict[str, Any]:
    """Return several runs of one method (its training seeds) on the same scenes as one JSON object.

    Interquartile means are over the runs; their intervals resample runs and, within each family, scenes. Both count the
    first drive of each scene, as the intervals of a single run do.
    """
    first = reports[0].result
    distinct = list({scene: index for index, scene in reversed(list(enumerate(reports[0].scenes)))}.values())[::-1]
    drives = [[report.records[index] for index in distinct] for report in reports]
    strata = [next((name for name in FAMILIES if record.scene.startswith(f"{name}-")), "") for record in drives[0]]
    lengths = [[spl(record) if record.static else None for record in records] for records in drives]
    known = [not any(one is None for one in of_scene) for of_scene in zip(*lengths, strict=True)]
    rng, means, intervals = random_streams.intervals(seed), {}, {}
    for outcome in Outcome:
        scores = np.array([[record.outcome is outcome for record in records] for records in drives], float)
        means[outcome.value], *intervals[outcome.value] = runs_95(scores, strata, rng)
    if any(known):
        scores = np.array(lengths, dtype=float)[:, known]
        means["spl"], *intervals["spl"] = runs_95(scores, list(np.array(strata)[known]), rng)
    return {
        "policies": [report.result["policy"] for report in reports],
        "scenes": first["scenes"],
        "episodes": first["episodes"],
        "seed": first["seed"],
        "interquartile_mean": means,
        "confidence_95": intervals,
        "runs": [report.result for report in reports],
    }


def show_together(result: dict[str, Any], console: PlainConsole) -> None:
    """Print the result of `together`."""
    rows = []
    for name, mean in result["interquartile_mean"].items():
        low, high = result["confidence_95"][name]
        each = (_figure(run[name]) for run in result["runs"])
        rows.append([LABELS[name], *each, f"{mean:.3f}", f"{low:.3f} to {high:.3f}"])
    numbers = (str(number) for number, _ in enumerate(result["runs"], 1))
    console.say(f"{len(result['runs'])} runs on {result['scenes']}")
    console.print(table(("figure", *numbers, "interquartile mean", "95%"), rows))
    console.say(f"n {result['episodes']} each, seed {result['seed']}; bootstrap over runs and scenes.")


def _figure(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
