"""Figure that compares all policies: success and collision rates on each kind of scenes."""

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
    """Draw success and collision rates with 95% intervals, one panel per kind of scenes, best success at the top.

    Args:
        evaluations: evaluations to compare, at least one.
        folder: folder of the figures.

    Returns:
        The name of the PNG.
    """
    splits = list(dict.fromkeys(evaluation.scenes for evaluation in evaluations))
    groups = [by_label(evaluations, split) for split in splits]
    columns = min(COLUMNS, len(splits))
    rows = max(len(labels) for labels in groups)
    height = HEAD_IN + ROW_IN * rows
    figure, panels = style.panels(-(-len(splits) // columns), columns, 4.0, height)
    for axes, split, labels in zip(panels, splits, groups, strict=False):
        _draw_split(axes, labels, rows)
        axes.set_title(style.label(split))
    style.blank(panels[len(splits) :])
    marks = [
        Line2D([], [], marker=marker, color=style.OUTCOME_COLOURS[Outcome(key)], linestyle="none")
        for key, marker in zip(RATES, style.MARKERS, strict=False)
    ]
    figure.legend(marks, ["success", "collision"], loc="outside lower center", ncols=2)
    return style.save(figure, folder, "policies")


def _draw_split(axes: Axes, groups: dict[str, list[Evaluation]], rows: int) -> None:
    """Draw one panel; `rows` is the same for all panels, so that their lines are equally far apart."""
    order = sorted(groups, key=lambda label: rate(groups[label], RATES[0]).mean)
    for row, label in enumerate(order):
        for key, marker, offset in zip(RATES, style.MARKERS, (0.12, -0.12), strict=False):
            share, colour = rate(groups[label], key), style.OUTCOME_COLOURS[Outcome(key)]
            axes.plot([100 * share.low, 100 * share.high], [row + offset] * 2, color=colour, linewidth=1.6, alpha=0.45)
            axes.plot(100 * share.mean, row + offset, marker, color=colour, markersize=5.5)
    axes.set(xlim=(-3, 103), ylim=(len(order) - rows - 0.6, len(order) - 0.4), xlabel="episodes (%)")
    axes.set_yticks(range(len(order)), [style.label(name) for name in order])
    axes.grid(visible=False, axis="y")
