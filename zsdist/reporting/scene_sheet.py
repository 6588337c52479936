"""Sheets of scenes from above: many small maps in one picture, with the way of each and what is too narrow."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch

from zsdist.planning.grid import Grid
from zsdist.reporting import style
from zsdist.reporting.maps import add_legend, draw_scene
from zsdist.sim.scenes.diagnosis import Diagnosis
from zsdist.sim.scenes.scene import Scene

SUFFIXES = (".png", ".svg", ".pdf")
_LARGE_IN, _SMALL_IN = 3.6, 1.1  # sides of a panel, with few and with many scenes
_SIDE_IN = 24.0  # greatest width of a sheet
_DETAILED_IN = 2.2  # least side of a panel with axes
_WIDER = 1.3  # a sheet has so many times more columns than rows
_RING_M = 1.1
_WAY, _NEAR, _TOO_NARROW = style.BLUE, style.ORANGE, style.VERMILION


def draw_sheet(scenes: Sequence[Scene], grid: Grid, file: Path, diagnoses: Sequence[Diagnosis] | None = None) -> None:
    """Draw scenes as one sheet into a file; with diagnoses, their ways and narrow places too.

    Args:
        scenes: scenes, at least one.
        grid: planning grid.
        file: PNG, SVG or PDF to write.
        diagnoses: diagnosis of each scene; None: the scenes alone.
    """
    columns = max(min(math.ceil(math.sqrt(_WIDER * len(scenes))), len(scenes)), 1)
    side_in = min(_LARGE_IN, max(_SIDE_IN / columns, _SMALL_IN))
    figure, panels = style.panels(-(-len(scenes) // columns), columns, side_in, side_in * 1.08)
    detailed = side_in >= _DETAILED_IN
    for index, (axes, scene) in enumerate(zip(panels, scenes, strict=False)):
        draw_scene(axes, scene, grid.arena_m)
        if diagnoses is not None:
            _draw_diagnosis(axes, diagnoses[index], grid)
        half = grid.side_m / 2
        axes.plot([-half, half, half, -half, -half], [-half, -half, half, half, -half], color=style.GREY, linewidth=0.6)
        if not detailed:
            axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
            axes.title.set_fontsize(max(10 * side_in / _LARGE_IN, 4.5))
            axes.set_title(scene.name if len(scene.name) <= 24 else f"{scene.name[:11]}…{scene.name[-12:]}")
    style.blank(panels[len(scenes) :])
    more: dict[str, Artist] = {"planning grid": Line2D([], [], color=style.GREY, linewidth=0.8)}
    if diagnoses is not None:
        more |= _marks(diagnoses)
    add_legend(figure, scenes, more)
    figure.savefig(file, dpi=style.DPI, bbox_inches="tight", pad_inches=0.1)


def _draw_diagnosis(axes: Axes, found: Diagnosis, grid: Grid) -> None:
    half = grid.side_m / 2
    shown = np.zeros((*found.reachable.shape, 4))
    shown[found.reachable] = (0.0, 0.45, 0.7, 0.13)
    axes.imshow(shown, origin="lower", extent=(-half, half, -half, half), interpolation="nearest", zorder=0.5)
    for path, colour, line in ((found.way, _WAY, "-"), (found.near, _NEAR, (0, (2, 1.4)))):
        if path is not None:
            points = np.array([grid.centre(state.ix, state.iy) for state in path.states])
            axes.plot(*points.T, color="white", linewidth=2.8, zorder=4)
            axes.plot(*points.T, color=colour, linestyle=line, linewidth=1.5, zorder=5)
    for place in found.narrow:
        colour = _TOO_NARROW if found.reason is not None else _WAY
        middle = (place.x_m, place.y_m)
        reach = place.width_m / 2 * np.array([math.cos(place.across_rad), math.sin(place.across_rad)])
        axes.plot(*np.array([middle - reach, middle + reach]).T, "|-", color=colour, linewidth=1.5, zorder=6)
        if found.reason is not None:
            axes.add_patch(Circle(middle, _RING_M, fill=False, edgecolor=colour, linewidth=1.8, zorder=6))
        text = axes.annotate(
            f"{place.width_m:.2f} m", middle, (0, 14), textcoords="offset points", ha="center", fontsize=7, zorder=8
        )
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0})
    if found.reason is not None:
        axes.set_title(f"{axes.get_title(loc='left')}: no way", color=_TOO_NARROW)


def _marks(diagnoses: Sequence[Diagnosis]) -> dict[str, Artist]:
    marks: dict[str, Artist] = {"can be reached": Patch(facecolor=_WAY, alpha=0.25)}
    if any(found.way is not None for found in diagnoses):
        marks["shortest way"] = Line2D([], [], color=_WAY, linewidth=1.5)
        marks["its narrowest place"] = Line2D([], [], color=_WAY, marker="|", linewidth=1.5, markersize=7)
    if any(found.near is not None for found in diagnoses):
        marks["way of a smaller car"] = Line2D([], [], color=_NEAR, linestyle=(0, (2, 1.4)), linewidth=1.5)
        marks["too narrow"] = _ring(_TOO_NARROW)
    return marks


def _ring(colour: str) -> Line2D:
    return Line2D([], [], marker="o", color=colour, markerfacecolor="none", linestyle="none", markersize=9)
