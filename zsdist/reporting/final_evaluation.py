"""End of a finished run: figures of its training, and a comparison of the trained policy with others."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.table import Table

from zsdist.common import commands
from zsdist.common.allowed_resources import allowed_cores
from zsdist.common.console import PlainConsole, table
from zsdist.config import Config
from zsdist.evaluation.contenders import FULL, Contender
from zsdist.evaluation.report import Report, Trial, evaluate_all
from zsdist.evaluation.selection import select
from zsdist.reporting import curves, results_board, runs
from zsdist.reporting.maps import DrivenPath, draw_paths
from zsdist.run import board
from zsdist.run.checkpoint import Policy, check_vision, load_policy
from zsdist.sim.scenes.families import SINGLETON_SCENES

PATHS_SHOWN = 6
TRAINING_EPISODES_A_DRIVE = 5  # for each final drive of a policy, so that the evaluation stays short
UNSEEN = "iid"  # family of unseen scenes, for a policy that was trained on the singleton family
SINGLETON = "singleton"


def draw_training(folder: Path) -> None:
    """Draw rewards and outcomes over training episodes into `figures/`."""
    run = runs.read_run(folder)
    if run.episodes:
        methods = [runs.Method(run.method, [run], ())]
        curves.draw_rewards(methods, folder / "figures")
        curves.draw_outcomes(methods, folder / "figures")


def compare(folder: Path, settings: Config, console: PlainConsole) -> None:
    """Drive the trained policy and others greedily; print a table, write `evaluation.json` and figures of paths."""
    episodes = min(settings.run.final_evaluation_episodes, settings.run.episodes // TRAINING_EPISODES_A_DRIVE)
    if not episodes:
        console.say("no evaluation: the run was too short, or run.final_evaluation_episodes is 0")
        results_board.add(folder)
        return
    trained = load_policy(folder, (), console.say)
    if note := check_vision(trained):
        console.say(note)
    compared = list(trials(trained, settings, episodes))
    drives = "; ".join(f"{trial.name} {trial.episodes} on {trial.scenes}" for trial in compared)
    console.say(f"evaluating greedily, {sum(trial.episodes for trial in compared)} drives: {drives}")
    reports = list(zip(compared, evaluate_all(compared, seed=settings.seed, workers=allowed_cores()), strict=True))
    (folder / "evaluation.json").write_text(
        json.dumps([report.result for _, report in reports], indent=1) + "\n", encoding="utf-8"
    )
    for trial, report in reports:
        if trial.name == "trained":
            scenes = select(trial.scenes, settings, trial.episodes, settings.seed)
            panels = [
                (scene, [DrivenPath(np.array(record.poses)[:, :2], record.outcome, "trained")])
                for scene, record in list(zip(scenes, report.records, strict=True))[:PATHS_SHOWN]
            ]
            draw_paths(panels, settings.grid.arena_m, folder / "figures", f"paths-{trial.scenes}")
    console.say("greedy evaluation")
    console.print(_table(reports))
    console.say(
        f"seed {settings.seed}, success within {settings.sim.success_radius_m} m, at most {settings.sim.max_steps} "
        "actions; 95% intervals"
    )
    console.say(f"figures: {folder / 'figures'}; those of the paper: {commands.module('zsdist.report', folder)}")
    results_board.add(folder)
    console.say(f"curves: {board.command(folder)}")


def trials(trained: Policy, settings: Config, episodes: int) -> Iterator[Trial]:
    """Yield the lines of the comparison.

    On scenes of the training family the trained policy is compared with its networks before training, on unseen scenes
    with baselines.

    Args:
        trained: trained policy.
        settings: configuration of its run.
        episodes: number of drives of each line, if there are as many scenes.
    """
    seen = settings.scenes.train[0]
    on_seen = min(episodes, SINGLETON_SCENES) if seen == SINGLETON else episodes
    for name, variant in (("trained", FULL), ("untrained", "untrained")):
        contender = Contender(settings, trained.parameters, variant=variant)
        yield Trial(name, contender, trained.sha256, seen, on_seen, lasts=variant != FULL)
    unseen = UNSEEN if seen == SINGLETON else "test"
    yield Trial("trained", Contender(settings, trained.parameters), trained.sha256, unseen, episodes)
    for baseline in ("random", "potential-field"):
        yield Trial(baseline, Contender(settings, baseline=baseline), None, unseen, episodes)


def _table(reports: list[tuple[Trial, Report]]) -> Table:
    rows = []
    for trial, report in reports:
        result = report.result
        low, high = result["confidence_95"]["success"]
        rows.append(
            [
                trial.scenes,
                trial.name,
                str(result["episodes"]),
                f"{result['success']:.2f} ({low:.2f}-{high:.2f})",
                f"{result['collision']:.2f}",
                f"{result['timeout']:.2f}",
                "-" if result["spl"] is None else f"{result['spl']:.2f}",
            ]
        )
    return table(("scenes", "policy", "n", "success", "collision", "timeout", "SPL"), rows, words=2)
