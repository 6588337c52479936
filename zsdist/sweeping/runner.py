"""Runner of a sweep: so many trials at once, each in processes of its own, whose failures stay apart."""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from zsdist.common.signals import Interruption
from zsdist.sweeping.folder import TrialFiles

LOOK_EVERY_S = 0.2
TELL_EVERY_S = 30.0
END_WITHIN_S = 10.0  # time for processes to end by themselves after a second signal
Stages = Callable[[TrialFiles], list[list[str]]]


@dataclass
class RunningTrial:
    """Trial under way.

    Attributes:
        files: its files.
        stages: commands that are left after the present one.
        process: present process.
    """

    files: TrialFiles
    stages: list[list[str]]
    process: subprocess.Popen[bytes] = field(init=False)

    def begin(self) -> None:
        """Start the next command. A signal of the terminal does not reach it: the sweep passes signals on."""
        self.files.log.parent.mkdir(parents=True, exist_ok=True)
        with self.files.log.open("ab") as log:
            self.process = subprocess.Popen(
                self.stages.pop(0),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={**os.environ, "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")},
                start_new_session=True,
            )

    def ask_to_stop(self) -> None:
        """Ask its process to save and stop; nothing happens where it has ended."""
        with contextlib.suppress(ProcessLookupError):
            self.process.send_signal(signal.SIGTERM)


def run(
    trials: Sequence[TrialFiles],
    at_once: int,
    interruption: Interruption,
    notify: Callable[[str], None],
    stages: Stages = TrialFiles.stages,
) -> dict[str, str]:
    """Train and evaluate trials until all have ended or an interruption has stopped them.

    Args:
        trials: the trials that are not complete.
        at_once: number of trials that run at the same time.
        interruption: tells whether to stop; the trials then save what they have.
        notify: called with lines for the user.
        stages: returns the commands of a trial; each must end with status 0.

    Returns:
        Why trials have failed, by name.
    """
    waiting, running = list(trials), list[RunningTrial]()
    failed: dict[str, str] = {}
    told_s, told, done = time.monotonic(), False, 0
    with _ended_at_last(running):
        while running or (waiting and not interruption()):
            while waiting and len(running) < at_once and not interruption():
                trial = RunningTrial(waiting[0], stages(waiting.pop(0)))
                trial.begin()
                running.append(trial)
                notify(f"{trial.files.trial.name}: begins")
            if interruption() and not told:
                told = True
                notify(
                    f"{interruption.name}: stopping {len(running)} trials, which save; a second signal stops at once"
                )
                for trial in running:
                    trial.ask_to_stop()
            for trial in list(running):
                status = trial.process.poll()
                if status is None:
                    continue
                name = trial.files.trial.name
                if status == 0 and trial.stages and not interruption():
                    trial.begin()
                    continue
                running.remove(trial)
                if status == 0 and not trial.stages:
                    done += 1
                    notify(f"{name}: done, {done} of {len(trials)}")
                elif not interruption():
                    failed[name] = trial.files.last_words(status)
                    notify(f"{name}: failed: {failed[name]}")
            if time.monotonic() - told_s > TELL_EVERY_S:
                told_s = time.monotonic()
                notify(_progress(running, len(waiting), done, len(failed)))
            time.sleep(LOOK_EVERY_S)
    return failed


@contextlib.contextmanager
def _ended_at_last(running: list[RunningTrial]) -> Iterator[None]:
    """End what still runs when the work is broken off: by a second signal or an error."""
    try:
        yield
    finally:
        for trial in running:
            trial.ask_to_stop()  # the second time for most: they do not save any longer
        until_s = time.monotonic() + END_WITHIN_S
        for trial in running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                trial.process.wait(max(0.0, until_s - time.monotonic()))
        for trial in running:
            trial.process.kill()
            trial.process.wait()


def _progress(running: Sequence[RunningTrial], waiting: int, done: int, failed: int) -> str:
    words = []
    for trial in running:
        files = trial.files
        wanted = files.trial.settings.run.episodes
        of = f"{files.episodes()} of {wanted} episodes" if trial.stages else "evaluation"
        words.append(f"{files.trial.name} {of}")
    return f"{done} done, {failed} failed, {waiting} waiting; {'; '.join(words)}"


def incomplete(trials: Sequence[TrialFiles]) -> list[TrialFiles]:
    """Return the trials without an evaluation as the plan wants it, in order."""
    return [trial for trial in trials if trial.result() is None]
