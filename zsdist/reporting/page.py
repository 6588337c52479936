"""Report of runs: the paper's figures and tables from our data, as one Markdown page with pictures."""

from collections.abc import Callable, Sequence
from pathlib import Path

from zsdist.errors import RunError, SceneError, WeightsError
from zsdist.evaluation.workers import Simulation
from zsdist.planning.grid import Grid
from zsdist.reporting import additions, comparison, convergence, curves, drives, guidance, maps, profiles, tables
from zsdist.reporting.markdown import code, escaped, figure, missing, table
from zsdist.reporting.runs import Evaluation, Material, Method, Run
from zsdist.run.checkpoint import Policy, load_policy

PAGE = "report.md"
INTERVALS = (
    "Intervals are 95%: Wilson for rates, bootstrap for means. Over several training seeds, rates are the "
    "interquartile mean with a bootstrap over seeds and scenes; other figures are the mean with minimum and maximum."
)


def write(material: Material, out: Path, on_step: Callable[[str], None], simulation: Simulation | None = None) -> Path:
    """Draw and write all figures and tables that the material allows, and list those that it does not.

    Args:
        material: runs and evaluations.
        out: folder of the page and its figures; made if it does not exist.
        on_step: called with the name of each step.
        simulation: simulation in which the paths are driven; None: physics and the camera.

    Returns:
        The page's path.

    Raises:
        RunError: the folder cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        lines = _lines(material, out, on_step, simulation)
        path = out / PAGE
        path.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    except OSError as error:
        raise RunError(f"--out {out} cannot be written: {error.strerror or error}") from error
    return path


def _lines(material: Material, out: Path, on_step: Callable[[str], None], simulation: Simulation | None) -> list[str]:
    trained = [method for method in material.methods if all(run.episodes for run in method.runs)]
    on_step("curves")
    lines = [
        "# Report",
        "",
        *_list_runs(material),
        "## Reward during training (Fig. 9)",
        "",
        *_rewards(trained, out),
        "## The singleton case (Sec. 4.4)",
        "",
        *_singleton(trained, material),
        "## Collisions during training",
        "",
        *_outcomes(trained, out),
    ]
    lines += _draw_drives(material, out, on_step, simulation)
    on_step("tables")
    reference = material.methods[0].name if material.methods else None
    first = material.runs[0] if material.runs else None
    lines += [
        "## Unseen environments (Table 4)",
        "",
        *tables.table_4(material.evaluations, additions.evaluate(first, "ood-layout")),
        INTERVALS,
        "",
        "## Baselines and ablations",
        "",
        *_compare_policies(material.evaluations, reference, out, first),
        "## What limits the policy: oracles",
        "",
        *tables.oracles(
            material.evaluations, reference, additions.evaluate(first, "ood-layout", "--variant", "oracle-depth")
        ),
        "## Size of replay and batch (Eqs. 21 to 23)",
        "",
        *_sizes(material.runs, out),
        "## The global policy's merges",
        "",
        *_merges(material.runs, out),
        "## Where the time went",
        "",
        *profiles.section(material.runs, out),
    ]
    return lines


def _compare_policies(
    evaluations: Sequence[Evaluation], reference: str | None, out: Path, first: Run | None
) -> list[str]:
    scenes = evaluations[0].scenes if evaluations else "ood-layout"
    compared = tables.every_policy(
        evaluations, reference, additions.evaluate_baseline(first, "potential-field", scenes)
    )
    if len({evaluation.label for evaluation in evaluations}) < 2:
        return compared
    caption = (
        "Every policy on each kind of scenes: rates of success and collision with 95% intervals. The tables give the "
        "numbers of episodes."
    )
    lines = figure(comparison.draw_policies(evaluations, out), caption)
    if reference is not None:
        lines += [
            f"{code(reference)}, the first method given, is the reference: the last column is the difference of "
            f"success to {code(reference)} on the scenes that both drove, with a bootstrap over scenes.",
            "",
        ]
    return lines + compared


def _list_runs(material: Material) -> list[str]:
    rows = [
        [
            code(run.folder.name),
            run.method,
            str(run.settings.seed),
            ", ".join(run.settings.scenes.train),
            str(len(run.episodes)),
            "-" if run.summary is None else str(run.summary["env_steps"]),
            "-" if run.summary is None else f"{run.summary['wall_s'] / 60:.1f}",
            "not ended" if run.summary is None else str(run.summary["ended"]),
        ]
        for run in material.runs
    ]
    lines = table(("run", "method", "seed", "trained on", "episodes", "env steps", "minutes", "ended"), rows)
    lines += ["Figs. 5 to 7 and Table 3 concern vision: `python -m zsdist.report --vision` writes them.", ""]
    for method in material.methods:
        if method.differing:
            lines += [
                f"**The runs of {escaped(method.name)} differ in more than the seed:** {_list(method.differing)}.",
                "",
            ]
    return lines if rows else missing("training, as no run directory was given", additions.train())


def _rewards(methods: Sequence[Method], out: Path) -> list[str]:
    if not methods:
        return missing("no run with a finished episode was given", additions.train())
    blind = [method.name for method in methods if not _has_vision(method.runs[0])]
    seeing = [method.name for method in methods if _has_vision(method.runs[0])]
    seeds = ", ".join(f"{method.name} {len(method.runs)}" for method in methods)
    caption = (
        "Cumulative average of the paper's reward over training, exploration included. "
        "a: mean return of the last episodes; b: mean reward of all actions so far, as in Eq. 21; c: score of the "
        f"promoted networks when they drive greedily. Runs: {seeds}. For several seeds, the line is their mean and the "
        "band extends from minimum to maximum, over the episodes that all seeds have."
    )
    lines = figure(curves.draw_rewards(methods, out), caption)
    if blind and seeing:
        return [*lines, f"With vision: {_list(seeing)}. Without: {_list(blind)}.", ""]
    other = "without vision" if seeing else "with vision"
    adding = additions.train("vision.rays=none", "run.name=without-vision") if seeing else additions.train()
    return [*lines, *missing(f"the comparison with and without vision, as no run {other} was given", adding)]


def _list(names: Sequence[str]) -> str:
    return escaped(", ".join(names))


def _has_vision(run: Run) -> bool:
    return run.settings.vision.rays != "none"


def _singleton(methods: Sequence[Method], material: Material) -> list[str]:
    if not methods:
        return missing("no run with a finished episode was given", additions.train())
    share, tenth = f"{convergence.BAND_SHARE:.0%}", f"{convergence.LAST_SHARE:.0%}"
    lines = [
        f"Final value: mean of the curve over the last {tenth} of the episodes. Converged: the episode from which the "
        f"curve stays within {share} of its range of the final value. Fluctuation: root mean square of returns about "
        "their running mean. Efficiency: fewest possible actions divided by those taken, over successful greedy "
        "episodes. The paper gives one cumulative average reward and does not define what it averages over; it is "
        "listed in one column, and was measured on its own scenes in its own simulator.",
        "",
        *tables.singleton(methods, material.evaluations),
    ]
    other = [method.name for method in methods if method.runs[0].settings.scenes.train != (tables.SINGLETON,)]
    if other:
        lines += [f"Not trained in the singleton scenes: {_list(other)}.", ""]
    least = convergence.LEAST_EPISODES
    short = [run for method in methods for run in method.runs if len(run.episodes) < least]
    if short:
        names = ", ".join(run.folder.name for run in short)
        lines += missing(
            f"values of {names}, which have fewer than {least} episodes", additions.train_on(short[0], least)
        )
    return lines


def _outcomes(methods: Sequence[Method], out: Path) -> list[str]:
    if not methods:
        return missing("no run with a finished episode was given", additions.train())
    caption = (
        f"Outcomes of training episodes, as shares of the last {curves.OUTCOME_WINDOW}. Exploration is included, and a "
        "share of the episodes is driven without the shield."
    )
    return [*figure(curves.draw_outcomes(methods, out), caption), *tables.training_outcomes(methods)]


def _draw_drives(
    material: Material, out: Path, on_step: Callable[[str], None], simulation: Simulation | None
) -> list[str]:
    """Draw Figs. 8 and 10 to 12 with the first policy that can be loaded."""
    headings = (
        "## Environment (Fig. 8)",
        "## High-level guidance and path (Fig. 10)",
        "## Unseen environments (Fig. 11)",
        "## Paths in unseen environments (Fig. 12)",
    )
    found, reason = _load_first_policy(material.runs, on_step)
    if found is not None:
        try:
            captions, files = _drives_of(*found, out, on_step, simulation)
        except (SceneError, WeightsError) as error:  # scenes or vision weights of its configuration are missing
            found, reason = None, str(error)
    if found is None:
        return [
            line
            for heading in headings
            for line in (heading, "", *missing(reason, "" if material.runs else additions.train()))
        ]
    drawn = zip(headings, files, captions, strict=True)
    return [line for heading, file, caption in drawn for line in (heading, "", *figure(file, caption))]


def _drives_of(
    run: Run, policy: Policy, out: Path, on_step: Callable[[str], None], simulation: Simulation | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return captions and files of the figures of a policy's drives, in the order of the headings."""
    label = f"{run.method}, seed {run.settings.seed}"
    driven = drives.drive(policy, run.method, lambda name: on_step(f"driving {name}"), simulation)
    grid, arena_m = Grid.from_config(policy.config.grid), policy.config.grid.arena_m
    home, unseen = drives.home_scene(policy), drives.unseen_scenes(policy)
    captions = (
        f"A training scene of {label}, as a grid map with the 4 x 4 blocks, and rendered. Obstacles are assigned to "
        "cells by area.",
        f"Values of the high-level network of {label} for each block, and the path driven greedily, in a training "
        "scene and in an unseen one. An arrow points to the choice with the highest value; the colour is the "
        "difference of that value to the mean of all choices, over eight headings, on the map known at the end of the "
        "drive. Grey: not known to be reachable. One episode each.",
        f"Scenes that no policy was trained on, as grid maps: families {', '.join(policy.config.scenes.test)} in turn.",
        f"Greedy paths of {label} in these scenes, one episode each, at most {policy.config.sim.max_steps} actions. "
        "Dashed: A* over position and heading on the whole true map.",
    )
    files = (
        maps.draw_grid_maps([home], grid, out, "fig08-environment", picture=True),
        guidance.draw_guidance(driven.guidance, policy.config, out),
        maps.draw_grid_maps(unseen, grid, out, "fig11-unseen"),
        maps.draw_paths(driven.paths, arena_m, out, "fig12-paths"),
    )
    return captions, files


def _load_first_policy(runs: Sequence[Run], notify: Callable[[str], None]) -> tuple[tuple[Run, Policy] | None, str]:
    reason = "no run directory was given"
    for run in runs:
        try:
            return (run, load_policy(run.folder, (), notify)), ""
        except WeightsError as error:
            reason = str(error)
    return None, reason


def _sizes(runs: Sequence[Run], out: Path) -> list[str]:
    shown = [run for run in runs if any("replay_low_capacity" in row for row in run.metrics)]
    if not shown:
        return missing("no run with figures of its replay was given", additions.train())
    caption = (
        "Size of the replay buffer and of the batch over training. a: capacity of the buffer (solid) and transitions "
        "in it (dotted), low level; b: batch size; c: the mean return that sets both, with its target (dashed). Dotted "
        "grey: minimum and maximum allowed."
    )
    return figure(curves.draw_sizes(shown, out), caption)


def _merges(runs: Sequence[Run], out: Path) -> list[str]:
    merged = [run for run in runs if run.merges]
    if not merged:
        if not runs:
            return missing("no run with a merge was given", additions.train())
        episodes = max(len(runs[0].episodes), runs[0].settings.merge.every_episodes)
        return missing("no run with a merge was given", additions.train_on(runs[0], episodes))
    caption = (
        "Merges: each candidate pair drives the same validation scenes greedily, and the best is promoted to the "
        "target network. A candidate that is clearly worse drives fewer scenes."
    )
    return [*figure(curves.draw_merges(merged, out), caption), *tables.merges(merged)]
