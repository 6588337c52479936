"""Files of a sweep: run directories, and beside them in `trials/` the settings, output and evaluation of each."""

import json
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zsdist import config
from zsdist.common import atomic_files, commands
from zsdist.errors import ConfigError, RunError
from zsdist.sweeping.plan import SweepPlan, SweepTrial

TRIALS = "trials"
_LOG_BYTES = 8192  # end of an output in which the last words are looked for


@dataclass(frozen=True)
class TrialFiles:
    """Files and commands of one trial.

    Attributes:
        folder: folder of the sweep.
        plan: plan of the sweep.
        trial: the trial.
    """

    folder: Path
    plan: SweepPlan
    trial: SweepTrial

    @property
    def run(self) -> Path:
        """Run directory."""
        return self.folder / self.trial.name

    @property
    def log(self) -> Path:
        """Output of its processes."""
        return self._path("log")

    def _path(self, suffix: str) -> Path:
        return self.folder / TRIALS / f"{self.trial.name}.{suffix}"

    def prepare(self) -> None:
        """Write the settings of the trial, which never change again.

        Raises:
            RunError: the trial has begun with other settings.
        """
        file = self._path("yaml")
        if file.exists():
            try:
                same = config.load(file) == self.trial.settings
            except ConfigError:  # written by another version, or by hand
                same = False
            if same:
                return
            if self.run.exists():
                raise RunError(
                    f"trial {self.trial.name} in {self.folder} has begun with other settings than the sweep's file now "
                    f"gives it; sweep into another folder (--out), or remove {commands.quoted(self.run)}"
                )
            self._path("json").unlink(missing_ok=True)
        file.parent.mkdir(parents=True, exist_ok=True)
        atomic_files.replace(file, config.dump(self.trial.settings).encode())

    def stages(self) -> list[list[str]]:
        """Return the commands that train and evaluate the trial; each goes on where it was broken off."""
        evaluation, python = self.plan.evaluation, [sys.executable, "-m"]
        train = [*python, "zsdist.launch", "--plain", "--auto-resume"]
        train += ["--run-dir", str(self.run), "--config", str(self._path("yaml"))]
        evaluate = [*python, "zsdist.evaluate", str(self.run), "--scenes", evaluation.scenes]
        evaluate += ["--episodes", str(evaluation.episodes), "--seed", str(evaluation.seed)]
        evaluate += ["--workers", str(self.plan.cores_per_trial), "--json", str(self._path("json"))]
        return [train, [*evaluate, "--out", str(self._path("jsonl")), "--resume"]]

    def result(self) -> dict[str, Any] | None:
        """Return the evaluation of the trial; None where there is none as the plan wants it."""
        result, wanted = _read(self._path("json")), self.plan.evaluation
        about = {name: result.get(name) for name in ("scenes", "episodes", "seed")}
        return result if about == wanted.model_dump() else None

    def summary(self) -> dict[str, Any]:
        """Return the summary of the training; empty before its end."""
        return _read(self.run / "summary.json")

    def episodes(self) -> int:
        """Return the number of training episodes that have finished."""
        file = self.run / "episodes.jsonl"
        return file.read_bytes().count(b"\n") if file.is_file() else 0

    def last_words(self, status: int) -> str:
        """Return why its process has ended with a status, in one line."""
        if status < 0:
            return f"killed by {signal.Signals(-status).name}"
        end = self.log.read_bytes()[-_LOG_BYTES:].decode(errors="replace") if self.log.is_file() else ""
        lines = [line.strip() for line in end.splitlines() if line.strip()]
        errors = [line for line in lines if "rror: " in line]
        return (errors or lines or ["without a word"])[-1] + f" (status {status})"


def _read(file: Path) -> dict[str, Any]:
    """Return the JSON object in a file; an empty one where there is none, or another process is writing it."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
