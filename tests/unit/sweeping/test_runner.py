"""Trials of a sweep, with small programs in place of training and evaluation."""

import os
import sys

import pytest

from zsdist.common.signals import Interruption
from zsdist.errors import RunError
from zsdist.sweeping import plan, runner
from zsdist.sweeping.folder import TrialFiles


def program(code, *words):
    return [sys.executable, "-I", "-S", "-c", code, *map(str, words)]


def files_of(tmp_path, text="seeds: [0, 1, 2]"):
    file = tmp_path / "s.yaml"
    file.write_text(text)
    made, trials = plan.read(file)
    return [TrialFiles(tmp_path / "out", made, trial) for trial in trials]


MARK = "import pathlib, sys; pathlib.Path(sys.argv[1]).touch()"


def test_each_trial_is_trained_and_then_evaluated(tmp_path):
    def stages(files):
        trained, evaluated = (tmp_path / f"{files.trial.name}.{what}" for what in ("trained", "evaluated"))
        return [
            program(MARK, trained),
            program(f"{MARK} if pathlib.Path(sys.argv[2]).exists() else 1/0", evaluated, trained),
        ]

    said = []
    assert runner.run(files_of(tmp_path), 2, Interruption(), said.append, stages) == {}
    assert len(list(tmp_path.glob("*.evaluated"))) == 3
    assert any("3 of 3" in line for line in said)


def test_a_trial_that_fails_or_dies_is_named_and_the_others_are_done(tmp_path):
    ends = {
        0: "print('zsdist.launch: error: no room'); print('bye'); raise SystemExit(2)",
        1: "import os, signal; os.kill(os.getpid(), signal.SIGKILL)",
        2: MARK,
    }
    found = runner.run(
        files_of(tmp_path),
        3,
        Interruption(),
        lambda line: None,
        lambda files: [program(ends[files.trial.seed], tmp_path / "done")],
    )
    assert found == {"base-seed-0": "zsdist.launch: error: no room (status 2)", "base-seed-1": "killed by SIGKILL"}
    assert (tmp_path / "done").exists()


class WhenReady(Interruption):
    """Interruption that comes once a file is there."""

    def __init__(self, file):
        super().__init__()
        self.file = file

    def __call__(self):
        return self.file.exists()


def test_an_interruption_lets_trials_save_and_begins_no_other(tmp_path):
    saving = (
        "import pathlib, signal, sys\n"
        "def save(*_): pathlib.Path(sys.argv[2]).touch(); sys.exit(143)\n"
        "signal.signal(signal.SIGTERM, save); pathlib.Path(sys.argv[1]).touch(); signal.pause()"
    )
    ready, saved, said = tmp_path / "ready", tmp_path / "saved", []
    found = runner.run(
        files_of(tmp_path), 1, WhenReady(ready), said.append, lambda files: [program(saving, ready, saved)]
    )
    assert found == {} and saved.exists()
    assert sum("begins" in line for line in said) == 1


def test_nothing_runs_on_after_an_error(tmp_path):
    pipe, pids = tmp_path / "pid", []
    os.mkfifo(pipe)
    code = "import os, pathlib, signal, sys; pathlib.Path(sys.argv[1]).write_text(str(os.getpid())); signal.pause()"

    def stages(files):
        if files.trial.seed:
            pids.append(int(pipe.read_text()))  # once the first one runs
            raise OSError("no more")
        return [program(code, pipe)]

    with pytest.raises(OSError, match="no more"):
        runner.run(files_of(tmp_path), 2, Interruption(), lambda line: None, stages)
    with pytest.raises(ProcessLookupError):
        os.kill(pids[0], 0)


def test_a_trial_keeps_the_settings_with_which_it_has_begun(tmp_path):
    (first, *_) = files_of(tmp_path)
    first.prepare()
    first.prepare()
    (changed, *_) = files_of(tmp_path, "seeds: [0]\nvariants: {base: {agent.trail: 0}}")
    changed.prepare()  # nothing has run yet
    first.run.mkdir(parents=True)
    with pytest.raises(RunError, match=r"base-seed-0 in .* has begun with other settings"):
        first.prepare()
    changed.prepare()
