"""`python -m zsdist.evaluate POLICY`: drives a policy greedily through scenes and says how it did."""

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from zsdist import cli
from zsdist import config as configuration
from zsdist.errors import RunError, WeightsError
from zsdist.evaluation.baselines import BASELINES
from zsdist.evaluation.metrics import EpisodeRecord, summarise
from zsdist.evaluation.selection import select
from zsdist.evaluation.workers import Entrant, drive_all
from zsdist.run.checkpoint import load_policy
from zsdist.types import Outcome

PLAIN_EVERY_S = 5.0
LABELS = {
    "success": "success",
    "collision": "collision",
    "timeout": "timeout",
    "spl": "SPL",
    "soft_spl": "SoftSPL",
    "path_efficiency": "path efficiency",
    "min_clearance_m": "least clearance (m)",
}


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = cli.Parser(prog="zsdist.evaluate", description=__doc__)
    parser.add_argument("policy", nargs="?", help="a run directory, a checkpoint, or a baseline (--list names them)")
    parser.add_argument("--list", action="store_true", help="name the baselines and leave")
    parser.add_argument(
        "--scenes", default="test", help="a folder of scene files, a family, or train, validation, test (default: test)"
    )
    parser.add_argument("--episodes", type=_count, help="default: every file of a folder, else 50")
    parser.add_argument("--seed", type=_seed, default=0, help="which scenes of a family (default: 0)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result there")
    parser.add_argument("--config", type=Path, metavar="FILE", help="world of a baseline; a run brings its own")
    parser.add_argument("--workers", type=_count, default=os.cpu_count() or 1, help="processes (default: all cores)")
    return parser


def main(options: argparse.Namespace) -> int:
    """Runs the command; returns its exit status."""
    if options.list:
        for name, baseline in BASELINES.items():
            print(f"{name:16} {baseline.line} (sees {baseline.sees})")
        return 0
    if options.policy is None:
        raise RunError(f"no policy was named; allowed are a run directory, a checkpoint and {', '.join(BASELINES)}")
    entrant, sha256 = find_policy(options.policy, options.config)
    if options.json is not None and not options.json.resolve().parent.is_dir():
        raise RunError(f"--json {options.json}: there is no folder {options.json.parent}")
    report = evaluate(
        entrant,
        policy=options.policy,
        weights_sha256=sha256,
        scenes=options.scenes,
        episodes=options.episodes,
        seed=options.seed,
        workers=options.workers,
    )
    if options.json is not None:
        options.json.write_text(json.dumps(report.result, indent=1, allow_nan=False) + "\n")
    report.show(Console())
    return 0


@dataclass(frozen=True)
class Report:
    """One evaluation: `result` is its JSON; `records` are its episodes, with their paths."""

    entrant: Entrant
    result: dict[str, Any]
    records: Sequence[EpisodeRecord] = field(repr=False)

    def show(self, console: Console) -> None:
        """Prints the figures with what they stand on."""
        result, settings = self.result, self.entrant.config.sim
        table = Table(title=f"{result['policy']} on {result['scenes']}", title_justify="left")
        table.add_column("figure")
        table.add_column("value", justify="right")
        table.add_column("95%", justify="right")
        for name, label in LABELS.items():
            value, interval = result[name], result["confidence_95"].get(name)
            table.add_row(
                label,
                "-" if value is None else f"{value:.3f}",
                f"{interval[0]:.3f} to {interval[1]:.3f}" if interval else "-",
            )
        decision = result["decision_ms"]
        table.add_row("decision (ms), p50 / p99", f"{decision['p50']:.1f} / {decision['p99']:.1f}", "-")
        console.print(table)
        decisions = sum(record.steps for record in self.records)
        changed = sum(record.shield_changes for record in self.records)
        console.print(
            f"n {result['episodes']}, seed {result['seed']}, success within {settings.success_radius_m} m, at most "
            f"{settings.max_steps} actions; sees {self.entrant.sees}; shield changed {changed} of {decisions} actions."
        )
        if not self.entrant.baseline:
            trained = ", ".join(self.entrant.config.scenes.train)
            console.print(f"Trained on {trained}; weights {result['weights_sha256'][:16]}.")


def find_policy(name: str, config_file: Path | None = None) -> tuple[Entrant, str | None]:
    """Who is meant by a POLICY argument, and the hash of its weights (None for a baseline).

    Raises:
        WeightsError: it is neither a baseline nor a place with weights.
        ConfigError: the configuration file is wrong.
    """
    if name in BASELINES:
        return Entrant(configuration.load(config_file), baseline=name), None
    if config_file is not None:
        raise RunError(f"--config {config_file}: a learned policy brings its own configuration; leave the option out")
    if not Path(name).exists():
        raise WeightsError(
            f"policy {name!r} is no folder; allowed are a run directory, a checkpoint and {', '.join(BASELINES)}"
        )
    policy = load_policy(Path(name))
    return Entrant(policy.config, policy.parameters), policy.sha256


def evaluate(
    entrant: Entrant,
    *,
    policy: str,
    weights_sha256: str | None,
    scenes: str,
    episodes: int | None,
    seed: int,
    workers: int,
) -> Report:
    """Drives the episodes with progress on the standard error stream.

    Args:
        entrant: who drives.
        policy: what the result calls it.
        weights_sha256: of its networks.
        scenes: a folder, a family or a split, as `selection.select` takes them.
        episodes: how many; None: every file of a folder, else 50.
        seed: of scenes and drivers.
        workers: processes.
    """
    chosen = select(scenes, entrant.config, episodes, seed)
    with _Progress(policy, len(chosen)) as progress:
        records = drive_all(entrant, chosen, seed, workers, progress.count)
    about = {
        "policy": policy,
        "weights_sha256": weights_sha256,
        "scenes": scenes,
        "episodes": len(records),
        "seed": seed,
    }
    return Report(entrant, about | summarise(records, np.random.default_rng(seed)), records)


class _Progress(AbstractContextManager):
    """A bar on a terminal, else a plain line every few seconds."""

    def __init__(self, title: str, total: int) -> None:
        self._title, self._total = title, total
        self._outcomes = dict.fromkeys(Outcome, 0)
        self._said_s = time.monotonic()
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        self._bar = Progress(*columns, console=Console(stderr=True), transient=True) if sys.stderr.isatty() else None
        self._task = self._bar.add_task(title, total=total) if self._bar else None

    def __enter__(self) -> "_Progress":
        (self._bar or nullcontext()).__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        (self._bar or nullcontext()).__exit__(*error)

    def count(self, record: EpisodeRecord) -> None:
        """One more episode is over."""
        self._outcomes[record.outcome] += 1
        line = ", ".join(f"{outcome} {count}" for outcome, count in self._outcomes.items())
        if self._bar:
            self._bar.update(self._task, advance=1, description=f"{self._title}: {line}")
        elif time.monotonic() - self._said_s > PLAIN_EVERY_S:
            self._said_s = time.monotonic()
            print(
                f"{self._title}: {sum(self._outcomes.values())} of {self._total}: {line}", file=sys.stderr, flush=True
            )


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"value is {text!r}; allowed is a whole number of 1 or more")
    return int(text)


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"value is {text!r}; allowed is a whole number of 0 or more")
    return int(text)


if __name__ == "__main__":
    cli.execute(main, make_parser())
