"""Figures of a training: rewards (Fig. 9), outcomes of episodes, replay and batch sizes, merges."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from zsdist.reporting import style
from zsdist.reporting.convergence import band, per_action, per_episode, returns, share
from zsdist.reporting.runs import Method, Run
from zsdist.types import Outcome

Curve = Callable[[Run], np.ndarray]
MANY_EPISODES = 400  # with more, single episodes are not drawn
OUTCOME_WINDOW = 20  # episodes of the running shares


def draw_rewards(methods: Sequence[Method], folder: Path) -> str:
    """Draw Fig. 9: both averages of the paper's reward over episodes, and the scores of the greedy policies.

    Args:
        methods: methods whose runs have at least one finished episode each.
        folder: folder of the figures.
    """
    figure, (left, middle, right) = style.panels(1, 3, 3.5, 3.1)
    for colour, method in zip(_cycled(style.CYCLE, methods), methods, strict=True):
        if len(methods) == len(method.runs) == 1 and len(method.runs[0].episodes) <= MANY_EPISODES:
            values = returns(method.runs[0])
            numbers = np.arange(1, len(values) + 1)
            left.plot(numbers, values, ".", color=colour, alpha=0.3, markersize=4, label="one episode")
        draw_band(left, method.runs, per_episode, colour, f"{_name(method)}, mean")
        draw_band(middle, method.runs, per_action, colour, _name(method))
    window = methods[0].runs[0].settings.replay.average_episodes
    left.set(title="a   per training episode", ylabel=f"return, mean of the last {window} episodes")
    middle.set(title="b   per action", ylabel="reward, mean of all actions so far")
    _draw_greedy(right, methods)
    for axes in (left, middle, right):
        axes.set_xlabel("finished training episodes")
        style.whole_numbers(axes)
        axes.set_xlim(left=0)
        style.legend(axes, loc="best")
    return style.save(figure, folder, "fig09-rewards")


def draw_outcomes(methods: Sequence[Method], folder: Path) -> str:
    """Draw collisions and successes during training, exploration included.

    Args:
        methods: methods whose runs have at least one finished episode each.
        folder: folder of the figures.
    """
    figure, axes = style.panels(1, 2, 4.2, 3.0)
    for one, outcome, title in zip(
        axes, (Outcome.COLLISION, Outcome.SUCCESS), ("a   collisions", "b   successes"), strict=True
    ):
        for colour, method in zip(_cycled(style.CYCLE, methods), methods, strict=True):
            draw_band(
                one,
                method.runs,
                partial(share, outcome=outcome, window=OUTCOME_WINDOW),
                colour,
                _name(method),
            )
        one.set(title=title, ylim=(-0.02, 1.02), xlabel="finished training episodes")
        one.set_ylabel(f"share of the last {OUTCOME_WINDOW} episodes")
        style.whole_numbers(one)
    style.legend(axes[0], loc="best")
    return style.save(figure, folder, "training-outcomes")


def draw_sizes(runs: Sequence[Run], folder: Path) -> str:
    """Draw the sizes of the replay buffer and of the batch over training, and the mean return that they follow.

    Args:
        runs: runs with metrics.
        folder: folder of the figures.
    """
    figure, axes = style.panels(1, 3, 3.5, 2.9)
    drawn = (
        (axes[0], "replay_low_capacity", "-", "steps-post"),
        (axes[0], "replay_low_size", ":", "default"),
        (axes[1], "replay_low_batch_size", "-", "steps-post"),
        (axes[2], "mean_return", "-", "default"),
    )
    for colour, run in zip(_cycled(style.CYCLE, runs), runs, strict=True):
        for one, key, line, steps in drawn:
            points = [(row["episodes"], row[key]) for row in run.metrics if "episodes" in row and key in row]
            if points:
                label = style.label(f"{run.method}, seed {run.settings.seed}")
                one.plot(*zip(*points, strict=True), line, color=colour, drawstyle=steps, label=label)
    settings = runs[0].settings.replay
    for one, limits in zip(
        axes, ((settings.size_min, settings.size_max), (settings.batch_min, settings.batch_max), ()), strict=True
    ):
        for limit in limits:
            one.axhline(limit, color=style.GREY, linewidth=0.8, linestyle=(0, (1, 3)))
    axes[2].axhline(settings.target_return, color=style.GREY, linewidth=0.8, linestyle="--")
    titles = ("a   replay buffer", "b   batch", "c   mean return, which sets both")
    labels = ("transitions of a level", "transitions", "mean return of the last episodes")
    for one, title, label in zip(axes, titles, labels, strict=True):
        one.set(title=title, ylabel=label, xlabel="finished training episodes")
        style.whole_numbers(one)
    axes[0].set_ylim(bottom=0)
    axes[1].set_ylim(bottom=0)
    style.legend(axes[2], loc="best")
    return style.save(figure, folder, "replay-sizes")


def draw_merges(runs: Sequence[Run], folder: Path) -> str:
    """Draw the scores of every candidate of every merge, and mark the promoted one.

    Args:
        runs: runs with at least one merge each.
        folder: folder of the figures.
    """
    columns = min(3, len(runs))
    rows = -(-len(runs) // columns)
    figure, axes = style.panels(rows, columns, 4.2, 2.9)
    names = list(dict.fromkeys(name for run in runs for merge in run.merges for name in merge["candidates"]))
    for one, run in zip(axes, runs, strict=False):
        merges = run.merges
        for index, name in enumerate(names):
            points = [(merge["episode"], merge["scores"][name]) for merge in merges if name in merge["scores"]]
            if points:
                marker, colour = style.MARKERS[index % len(style.MARKERS)], style.CYCLE[index % len(style.CYCLE)]
                one.plot(
                    *zip(*points, strict=True),
                    marker=marker,
                    color=colour,
                    linewidth=1,
                    label=name,
                    markersize=6,
                    clip_on=False,
                )
        chosen = [(merge["episode"], merge["scores"][merge["chosen"]]) for merge in merges]
        ring_style: dict[str, Any] = {"linestyle": "none", "label": "promoted", "markersize": 13, "clip_on": False}
        (ring,) = one.plot(*zip(*chosen, strict=True), "o", **ring_style)
        ring.set(markerfacecolor="none", markeredgecolor=style.BLACK)
        one.set(title=style.label(f"{run.method}, seed {run.settings.seed}"), xlabel="finished training episodes")
        one.set(ylim=(-1.15, 1.15))
        one.set_ylabel("success − collision, greedy")
        style.whole_numbers(one)
        one.set_xlim(left=0)
    style.blank(axes[len(runs) :])
    style.legend(axes[0], loc="lower right", ncols=2)
    return style.save(figure, folder, "merges")


def draw_band(axes: Axes, runs: Sequence[Run], curve: Curve, colour: str, label: str) -> None:
    """Draw the mean of a curve over runs, and where there are several a band from minimum to maximum."""
    mean, low, high = band([curve(run) for run in runs])
    numbers = np.arange(1, len(mean) + 1)
    if len(runs) > 1:
        axes.fill_between(numbers, low, high, color=colour, alpha=0.18, linewidth=0)
    axes.plot(numbers, mean, color=colour, label=label)


def _draw_greedy(axes: Axes, methods: Sequence[Method]) -> None:
    """Draw the scores of the promoted policies on the validation scenes at each merge."""
    for colour, method in zip(_cycled(style.CYCLE, methods), methods, strict=True):
        for run in method.runs:
            points = [(merge["episode"], merge["scores"][merge["chosen"]]) for merge in run.merges]
            if points:
                label = None if run is not method.runs[0] else _name(method)
                look: dict[str, Any] = {"linewidth": 1, "markersize": 5, "alpha": 0.8, "clip_on": False}
                axes.plot(*zip(*points, strict=True), "o-", color=colour, label=label, **look)
    axes.set(title="c   greedy, at each merge", ylabel="success − collision, validation scenes", ylim=(-1.15, 1.15))
    if not axes.lines:
        axes.text(0.5, 0.5, "no merge yet", transform=axes.transAxes, ha="center", color=style.GREY)


def _name(method: Method) -> str:
    seeds = len(method.runs)
    return style.label(method.name if seeds == 1 else f"{method.name}, {seeds} seeds")


def _cycled(values: Sequence[str], items: Sequence[object]) -> list[str]:
    return [values[index % len(values)] for index in range(len(items))]
