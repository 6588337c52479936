"""Comparison of two policies on the same scenes: paired differences with their intervals."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zsdist.common import random_streams
from zsdist.common.console import PlainConsole, table
from zsdist.errors import RunError
from zsdist.evaluation import episode_store
from zsdist.evaluation.episode_store import Line
from zsdist.evaluation.fingerprint import equivalent
from zsdist.evaluation.metrics import spl
from zsdist.evaluation.records import EpisodeRecord
from zsdist.evaluation.statistics import bootstrap_95
from zsdist.types import Outcome

LABELS = {"success": "success", "collision": "collision", "spl": "SPL"}
_Drive = tuple[str, int, int]  # hash of the scene, seed, index among the scenes: equal for a pair of episodes


@dataclass(frozen=True)
class Comparison:
    """Paired differences between the episodes of two files.

    Attributes:
        result: the comparison as a JSON object.
        notes: lines about episodes that were left out.
    """

    result: dict[str, Any]
    notes: Sequence[str]

    def show(self, console: PlainConsole) -> None:
        """Print the differences, with the means of both files."""
        result, rows = self.result, []
        for name, label in LABELS.items():
            figure = result["figures"].get(name)
            if figure:
                low, high = figure["confidence_95"]
                means = (f"{figure[key]:.3f}" for key in ("a", "b"))
                rows.append(
                    [label, str(figure["pairs"]), *means, f"{figure['difference']:+.3f}", f"{low:+.3f} to {high:+.3f}"]
                )
        console.say(f"{result['a']} against {result['b']}")
        console.print(table(("figure", "n", "first", "second", "difference", "95%"), rows))
        for note in self.notes:
            console.say(note)


def compare(first: Path, second: Path, seed: int = 0) -> Comparison:
    """Return paired differences over the episodes with the same scene, seed and index in both files.

    Where a file has several policies (training seeds of one method), a scene counts with their mean. Lines of older
    code, weights or settings do not count. Lines without the shield do not count where the file has others under it.
    The intervals are bootstraps over the pairs, of which each scene gives one. SPL covers the scenes in which nothing
    moves and the planner knows a path.

    Args:
        first: file of episodes.
        second: file of the episodes to compare with.
        seed: seed of the bootstrap.

    Raises:
        RunError: a file is damaged or empty, or they have no episode in common.
    """
    (ours, code, notes), (theirs, other, more) = _episodes(first), _episodes(second)
    if other not in equivalent(code):
        notes.append(f"the two files were measured with different code, {code} and {other}")
    paired = sorted(ours.keys() & theirs.keys(), key=lambda drive: drive[1:])
    shared = sorted({drive[0]: drive for drive in reversed(paired)}.values())  # the first drive of each scene
    if not shared:
        raise RunError(
            f"{first} and {second} have no scene, seed and index in common; allowed are files that have some"
        )
    rng, figures = random_streams.intervals(seed), {}
    for name in LABELS:
        pairs = [
            (a, b) for drive in shared if None not in (a := _mean(ours[drive], name), b := _mean(theirs[drive], name))
        ]
        if pairs:
            a, b = np.array(pairs, dtype=float).T
            figures[name] = {
                "pairs": len(pairs),
                "a": float(a.mean()),
                "b": float(b.mean()),
                "difference": float((a - b).mean()),
                "confidence_95": list(bootstrap_95(a - b, rng)),
            }
    for drives, file in ((ours, first), (theirs, second)):
        if left := len(drives) - len(paired):
            notes.append(f"{file}: {left} episodes have no partner and are left out")
    if left := len(paired) - len(shared):
        notes.append(f"{left} pairs repeat a scene and are left out")
    return Comparison({"a": str(first), "b": str(second), "episodes": len(shared), "figures": figures}, notes + more)


def _episodes(file: Path) -> tuple[dict[_Drive, list[EpisodeRecord]], str, list[str]]:
    """Return the records of each drive, one per policy; the hash of the newest code, which all have; and notes.

    Several policies are training seeds of one method. Each policy counts only with the weights and settings of its last
    line. Where any line is under the shield, only such lines count.
    """
    lines = episode_store.read(file)
    if not lines:
        raise RunError(f"{file} holds no episode; allowed are files that --out wrote")
    notes = []

    def only(lines: list[Line], counts: Callable[[Line], bool], others: str) -> list[Line]:
        kept = [line for line in lines if counts(line)]
        if left := len(lines) - len(kept):
            notes.append(f"{file}: {left} lines {others} are left out")
        return kept

    newest = lines[-1].about["code"]
    codes = equivalent(newest)
    lines = only(lines, lambda line: line.about["code"] in codes, f"of other code than {newest}")
    if any(line.about["shielded"] for line in lines):
        lines = only(lines, lambda line: line.about["shielded"], "without the shield")
    methods = sorted({_method(line) for line in lines})
    if len(methods) > 1:
        raise RunError(f"{file} holds episodes of {', '.join(methods)}; allowed is one of them, in one or more seeds")
    last = {line.about["policy"]: line.about["entrant"] for line in lines}
    lines = only(
        lines, lambda line: line.about["entrant"] == last[line.about["policy"]], "of older weights or settings"
    )
    latest = {(line.about["entrant"], *_drive(line)): line for line in lines}
    drives = defaultdict(list)
    for line in latest.values():
        drives[_drive(line)].append(line.record)
    return dict(drives), newest, notes


def _method(line: Line) -> str:
    """Return the name of a baseline, or the variant of a learned policy, whatever its weights."""
    about = line.about
    return f"the variant {about['variant']}" if about["weights_sha256"] else str(about["policy"])


def _drive(line: Line) -> _Drive:
    about = line.about
    return about["scene_hash"], about["seed"], about["index"]


def _mean(records: Sequence[EpisodeRecord], name: str) -> float | None:
    if name == "spl":
        values = [value for record in records if record.static and (value := spl(record)) is not None]
        return float(np.mean(values)) if values else None
    return float(np.mean([record.outcome is Outcome(name) for record in records]))
