"""Every policy beside every other: how often it arrived and how often it hit something, on each kind of scenes."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from zsdist.reporting import style
from zsdist.reporting.runs import Evaluation
from zsdist.reporting.tables import RATES, by_label, rate
from zsdist.types import Outcome

COLUMNS = 3
ROW_IN, HEAD_IN = 0.24, 0.75


def draw_policies(evaluations: Sequence[Evaluation], folder: Path) -> str:
    """Success and collisions with their 95% intervals, a panel a kind of scenes, best success on top.

    Args:
        evaluations: at least one.
        folder: of the figures.
    """
    splits = list(dict.fromkeys(evaluation.scenes for evaluation in evaluations))
    drove = [by_label(evaluations, split) for split in splits]
    columns = min(COLUMNS, len(splits))
    most = max(len(labels) for labels in drove)
    height = HEAD_IN + ROW_IN * most
    figure, panels = style.panels(-(-len(splits) // columns), columns, 4.0, height)
    for axes, split, labels in zip(panels, splits, drove, strict=False):
        _draw_split(axes, labels, most)
        axes.set_title(split)
    style.blank(panels[len(splits) :])
    marks = [
        Line2D([], [], marker=marker, color=style.OUTCOME_COLOURS[Outcome(key)], linestyle="none")
        for key, marker in zip(RATES, style.MARKERS, strict=False)
    ]
    figure.legend(marks, ["arrived", "hit something"], loc="outside lower center", ncols=2)
    return style.save(figure, folder, "policies")


def _draw_split(axes: Axes, drove: dict[str, list[Evaluation]], rows: int) -> None:
    """One panel; with fewer policies than `rows` its lower part stays empty, so that lines are as far apart in all."""
    order = sorted(drove, key=lambda label: rate(drove[label], RATES[0]).mean)
    for row, label in enumerate(order):
        for key, marker, aside in zip(RATES, style.MARKERS, (0.12, -0.12), strict=False):
            found, colour = rate(drove[label], key), style.OUTCOME_COLOURS[Outcome(key)]
            axes.plot([100 * found.low, 100 * found.high], [row + aside] * 2, color=colour, linewidth=1.6, alpha=0.45)
            axes.plot(100 * found.mean, row + aside, marker, color=colour, markersize=5.5)
    axes.set(xlim=(-3, 103), ylim=(len(order) - rows - 0.6, len(order) - 0.4), xlabel="episodes (%)")
    axes.set_yticks(range(len(order)), order)
    axes.grid(visible=False, axis="y")
