"""A whole evaluation: scenes chosen, driven with progress shown, summed up as JSON and as a table."""

import sys
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from zsdist.evaluation.metrics import EpisodeRecord, summarise
from zsdist.evaluation.selection import select
from zsdist.evaluation.workers import Entrant, drive_all
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
