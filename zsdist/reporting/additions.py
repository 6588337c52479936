"""Commands that add to a report what it has left out."""

from pathlib import Path

from zsdist.common import commands
from zsdist.reporting.runs import Run

NO_RUN = Path("runs/NAME")  # in commands, where no run was given


def train(*settings: str) -> str:
    """Return the command that trains a policy, with settings as `key.path=value`."""
    return commands.module("zsdist.launch", *(word for setting in settings for word in ("--set", setting)))


def train_on(run: Run, episodes: int) -> str:
    """Return the command that goes on with a run until it has so many episodes."""
    return commands.module("zsdist.launch", "--resume", run.folder, "--episodes", episodes)


def evaluate(run: Run | None, scenes: str, *options: str) -> str:
    """Return the command that evaluates the policy of a run on scenes, into its folder, where a report finds it."""
    folder = NO_RUN if run is None else run.folder
    name = "-".join((scenes, *(option for option in options if not option.startswith("-"))))
    return commands.module("zsdist.evaluate", folder, "--scenes", scenes, *options, "--json", folder / f"{name}.json")


def evaluate_baseline(run: Run | None, baseline: str, scenes: str) -> str:
    """Return the command that evaluates a baseline on scenes, into the folder of a run."""
    folder = NO_RUN if run is None else run.folder
    return commands.module(
        "zsdist.evaluate", baseline, "--scenes", scenes, "--json", folder / f"{baseline}-{scenes}.json"
    )
