"""Style of every figure: fonts, colours safe for colour-blind readers (Okabe and Ito), and file formats."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from zsdist.common.console import plain
from zsdist.types import Outcome

matplotlib.use("Agg")

BLACK, GREY, PALE = "#1a1a1a", "#7a7f85", "#c9cdd2"
BLUE, ORANGE, GREEN, PURPLE = "#0072b2", "#e69f00", "#009e73", "#cc79a7"
VERMILION, SKY, YELLOW = "#d55e00", "#56b4e9", "#f0e442"
CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
OUTCOME_COLOURS = {Outcome.SUCCESS: GREEN, Outcome.COLLISION: VERMILION, Outcome.TIMEOUT: ORANGE}
FONT = "DejaVu Sans"
DPI = 160
LONGEST_LABEL = 60

_RC: dict[str, Any] = {
    "font.family": FONT,
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.8,
    "axes.labelcolor": BLACK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e8ea",
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.8,
    "lines.solid_capstyle": "round",
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": BLACK,
    "ytick.labelcolor": BLACK,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "text.parse_math": False,  # a `$` in a name is a `$`
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "zsdist",  # equal figures give equal files
}
matplotlib.style.use(_RC)


def panels(rows: int, columns: int, width_in: float, height_in: float) -> tuple[Figure, list[Axes]]:
    """Return a figure and its `rows` by `columns` axes, row by row; each has the given size in inches."""
    figure = Figure(figsize=(columns * width_in, rows * height_in), layout="constrained")
    return figure, list(figure.subplots(rows, columns, squeeze=False).ravel())


def label(text: str) -> str:
    """Return a text from outside as a title or label: in one line, shortened in its middle if it is long."""
    shown = plain(text)
    if len(shown) > LONGEST_LABEL:
        half = LONGEST_LABEL // 2
        shown = f"{shown[:half]}…{shown[-half:]}"
    return f" {shown}" if shown.startswith("_") else shown  # legends leave out labels that begin with "_"


def legend(axes: Axes, **look: Any) -> None:
    """Draw a legend of what is labelled, where anything is."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(**look)


def whole_numbers(axes: Axes) -> None:
    """Set few, whole-numbered ticks along x, for a count."""
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))


def blank(axes: Iterable[Axes]) -> None:
    """Hide panels in which nothing is drawn."""
    for panel in axes:
        panel.set_axis_off()


def save(figure: Figure, folder: Path, name: str) -> str:
    """Write `name.png` and `name.svg` into a folder, made where it is missing; return the name of the PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{name}.png", dpi=DPI, bbox_inches="tight", pad_inches=0.08)
    figure.savefig(folder / f"{name}.svg", bbox_inches="tight", pad_inches=0.08, metadata={"Date": None})
    return f"{name}.png"
