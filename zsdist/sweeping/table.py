"""Table at the end of a sweep: one row for each variant over its seeds, as text, Markdown and JSON."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from zsdist.common import places, random_streams
from zsdist.common.console import PlainConsole
from zsdist.common.console import table as text_table
from zsdist.evaluation.statistics import runs_95
from zsdist.reporting import markdown
from zsdist.sweeping.folder import TrialFiles

HEAD = ("variant", "seeds", "success (95%)", "collision", "SPL", "env steps", "minutes")


def summarise(trials: Sequence[TrialFiles], failed: dict[str, str]) -> dict[str, Any]:
    """Return all trials and the figures of each variant as one JSON object.

    Args:
        trials: all trials of the sweep.
        failed: reasons of those that have failed.
    """
    rows = [_trial(trial, failed.get(trial.trial.name)) for trial in trials]
    variants = []
    for title in dict.fromkeys(row["variant"] for row in rows):
        mine = [row for row in rows if row["variant"] == title]
        variants.append(_variant(title, mine))
    for row in rows:
        row.pop("outcomes", None)
    return {"evaluation": trials[0].plan.evaluation.model_dump(), "variants": variants, "trials": rows}


def _trial(files: TrialFiles, failure: str | None) -> dict[str, Any]:
    result, summary = files.result(), files.summary()
    row: dict[str, Any] = {
        "variant": files.trial.title,
        "seed": files.trial.seed,
        "run": str(files.run),
        "state": "done" if result else "failed" if failure else "unfinished",
        "reason": None if result else failure,
        "env_steps": summary.get("env_steps"),
        "wall_s": summary.get("wall_s"),
    }
    if result:
        row |= {name: result[name] for name in ("success", "collision", "timeout", "spl")}
        row["success_95"] = result["confidence_95"]["success"]
        row["outcomes"] = {drive["scene"]: drive["outcome"] for drive in reversed(result["per_scene"])}
    return row


def _variant(title: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    done = [row for row in rows if row["state"] == "done"]
    found: dict[str, Any] = {"variant": title, "seeds": [row["seed"] for row in done]}
    found["unfinished_seeds"] = [row["seed"] for row in rows if row["state"] != "done"]
    for name in ("success", "collision", "timeout", "spl", "env_steps", "wall_s"):
        values = [row[name] for row in done if row[name] is not None]
        found[name] = sum(values) / len(values) if values else None
    found["success_95"] = None
    if len(done) == 1:
        found["success_95"] = done[0]["success_95"]
    elif done:  # interquartile mean over seeds; both count the first drive of each scene
        scenes = list(done[0]["outcomes"])[::-1]
        scores = np.array([[row["outcomes"].get(scene) == "success" for scene in scenes] for row in done], float)
        strata = [next((name for name in places.FAMILIES if scene.startswith(f"{name}-")), "") for scene in scenes]
        found["success"], *found["success_95"] = runs_95(scores, strata, random_streams.intervals(0))
    return found


def show(summary: dict[str, Any], console: PlainConsole) -> None:
    """Print the table of variants."""
    console.print(text_table(HEAD, _rows(summary)))
    console.say(_note(summary))


def as_markdown(summary: dict[str, Any]) -> str:
    """Return the table of variants, and the trials that are not done, as Markdown."""
    lines = ["# Sweep", "", *markdown.table(HEAD, _rows(summary)), markdown.escaped(_note(summary)), ""]
    missing = [row for row in summary["trials"] if row["state"] != "done"]
    for row in missing:
        reason = f": {row['reason']}" if row["reason"] else ""
        lines.append(markdown.escaped(f"{row['variant']}, seed {row['seed']}: {row['state']}{reason}"))
        lines.append("")
    return "\n".join(lines)


def _rows(summary: dict[str, Any]) -> list[list[str]]:
    return [
        [
            row["variant"],
            f"{len(row['seeds'])} of {len(row['seeds']) + len(row['unfinished_seeds'])}",
            "-" if row["success_95"] is None else "{:.2f} ({:.2f}-{:.2f})".format(row["success"], *row["success_95"]),
            _figure(row["collision"], ".2f"),
            _figure(row["spl"], ".2f"),
            _figure(row["env_steps"], ",.0f"),
            _figure(row["wall_s"] and row["wall_s"] / 60, ".1f"),
        ]
        for row in summary["variants"]
    ]


def _note(summary: dict[str, Any]) -> str:
    of = summary["evaluation"]
    return (
        f"{of['episodes']} drives each in scenes of {of['scenes']} (seed {of['seed']}); interquartile mean over seeds, "
        "bootstrap over seeds and scenes; collisions, SPL, steps and minutes of training are means"
    )


def _figure(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
