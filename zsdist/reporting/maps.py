"""Scenes from above: as grid maps (Figs. 8 and 11), and with driven paths (Fig. 12)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Rectangle
from matplotlib.transforms import Affine2D

from zsdist.planning.grid import FINE_PER_CELL, Grid
from zsdist.reporting import style
from zsdist.reporting.viewpoint import lifted_camera
from zsdist.sim.scenes.kinds import GROUNDS, KINDS
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Outcome, Pose

COLUMNS = 3
OUTLINE = 0.6  # width of the outline of obstacles in points, so that thin walls are seen
LEGEND_ENTRY_IN = 1.35  # width of an entry of a legend below a figure
BIRD_PX, BIRD_HEIGHT_M, BIRD_AWAY_M, BIRD_PITCH_DEG = 640, 17.0, 20.5, 42.0
CELL_SHARE = 0.4  # a cell belongs to an obstacle that touches at least this share of its fine cells
# The paper's colours where it has them: yellow sand, green trees, black people.
KIND_COLOURS = {
    "tree": "#2e7d32",
    "person": "#111111",
    "sand_pile": "#f0c419",
    "rock": "#8d8d8d",
    "bush": "#8bc34a",
    "pole": "#5b7fa6",
    "box": "#a1887f",
    "car": "#7e57c2",
}
START_COLOUR, GOAL_COLOUR = "#1fa64a", "#e02020"


@dataclass(frozen=True)
class DrivenPath:
    """One driven path.

    Attributes:
        points: `(n, 2)` positions in metres.
        outcome: outcome of the episode.
        label: name of the driver.
        reference: whether it is drawn as a thin dashed line, for comparison.
    """

    points: np.ndarray
    outcome: Outcome
    label: str
    reference: bool = False


def draw_paths(panels: Sequence[tuple[Scene, Sequence[DrivenPath]]], arena_m: float, folder: Path, name: str) -> str:
    """Draw scenes from above with the paths driven in them; a path's colour shows its outcome.

    Args:
        panels: scenes with their paths, at least one.
        arena_m: side of the arena.
        folder: folder of the figures.
        name: name of the figure.
    """
    rows = -(-len(panels) // COLUMNS)
    columns = min(COLUMNS, len(panels))
    figure, grid = style.panels(rows, columns, 3.3, 3.5)
    for axes, (scene, paths) in zip(grid, panels, strict=False):
        draw_scene(axes, scene, arena_m)
        for path in paths:
            draw_path(axes, path)
    style.blank(grid[len(panels) :])
    labelled = [pair for axes in grid[: len(panels)] for pair in zip(*axes.get_legend_handles_labels(), strict=True)]
    handles = {label: handle for handle, label in labelled}  # one of each: panels share most of their labels
    add_legend(figure, [scene for scene, _ in panels], handles)
    return style.save(figure, folder, name)


def draw_path(axes: Axes, path: DrivenPath) -> None:
    """Draw a path over a scene, with an outline so that it is visible on any ground."""
    points = np.asarray(path.points)
    label = f"{style.label(path.label)}: {path.outcome}" if path.label else str(path.outcome)
    if path.reference:
        axes.plot(*points.T, linestyle=(0, (3, 2)), color=style.BLACK, linewidth=1.1, label=label, zorder=3.5)
        return
    colour = style.OUTCOME_COLOURS[path.outcome]
    axes.plot(*points.T, color="white", linewidth=3.4, alpha=0.9, zorder=4)
    axes.plot(*points.T, color=colour, linewidth=1.9, label=label, zorder=5)
    if path.outcome is Outcome.COLLISION:
        axes.plot(*points[-1], "X", color=colour, markeredgecolor="white", markersize=9, zorder=6)


def draw_scene(axes: Axes, scene: Scene, arena_m: float) -> None:
    """Draw a scene with its obstacles in the colours of their kinds, and walking people with their paths."""
    axes.set_facecolor((*GROUNDS[scene.ground].base_colour, 0.28))
    for obstacle in scene.obstacles:
        colour = KIND_COLOURS[obstacle.kind]
        if obstacle.radius_m is not None:
            axes.add_patch(Circle((obstacle.x_m, obstacle.y_m), obstacle.radius_m, color=colour, linewidth=OUTLINE))
            if obstacle.walks:
                axes.plot(*np.array(obstacle.path).T, ":", color=colour, linewidth=1.2)
        elif obstacle.size_m is not None:
            length, width, _ = obstacle.size_m
            turn = Affine2D().rotate_deg(obstacle.heading_deg).translate(obstacle.x_m, obstacle.y_m)
            body = Rectangle((-length / 2, -width / 2), length, width, color=colour, linewidth=OUTLINE)
            body.set_transform(turn + axes.transData)
            axes.add_patch(body)
    draw_ends(axes, scene)
    square(axes, arena_m)
    axes.set_title(style.label(scene.name))


def draw_ends(axes: Axes, scene: Scene) -> None:
    """Draw the paper's marks: a green circle at the start, with a tick for the heading, and a red star at the goal."""
    x, y, heading = scene.start.pose
    tip = (x + 1.3 * math.cos(heading), y + 1.3 * math.sin(heading))
    axes.plot(*zip((x, y), tip, strict=True), color=START_COLOUR, linewidth=2, zorder=6, clip_on=False)
    axes.plot(x, y, "o", color=START_COLOUR, markeredgecolor="white", markersize=8, zorder=7, clip_on=False)
    axes.plot(*scene.goal, "*", color=GOAL_COLOUR, markeredgecolor="white", markersize=14, zorder=7, clip_on=False)


def cells_by_kind(scene: Scene, grid: Grid) -> np.ndarray:
    """Return the kind of obstacle in each cell, `(cells, cells)` `[iy, ix]`: index into `KINDS`, -1 where free.

    A cell belongs to an obstacle that covers at least `CELL_SHARE` of it or has its centre in it. People are at the
    position at which they start.
    """
    found = np.full((grid.cells, grid.cells), -1)
    covered = np.full((grid.cells, grid.cells), CELL_SHARE)
    border, names = grid.fine_border, list(KINDS)
    for obstacle in scene.obstacles:
        standing = replace(obstacle, path=(), speed_mps=0.0)
        fine = replace(scene, obstacles=(standing,)).occupancy(grid)
        inner = fine[border : grid.fine_size - border, border : grid.fine_size - border]
        parts = inner.reshape(grid.cells, FINE_PER_CELL, grid.cells, FINE_PER_CELL).mean(axis=(1, 3))
        if grid.contains(obstacle.x_m, obstacle.y_m):
            parts[grid.cell_at(obstacle.x_m, obstacle.y_m)[::-1]] = 1.0
        more = parts >= covered
        found[more], covered[more] = names.index(obstacle.kind), parts[more]
    return found


def draw_grid_map(axes: Axes, scene: Scene, grid: Grid) -> None:
    """Draw a scene as a grid map with the high-level blocks, as the paper does."""
    kinds = cells_by_kind(scene, grid)
    colours = np.array([to_rgb("white"), *(to_rgb(KIND_COLOURS[name]) for name in KINDS)])
    half = grid.side_m / 2
    axes.imshow(colours[kinds + 1], origin="lower", extent=(-half, half, -half, half), interpolation="nearest")
    for index in range(grid.cells + 1):
        at = index * grid.cell_size_m - half
        heavy = index % grid.block_size == 0
        for draw in (axes.axhline, axes.axvline):
            draw(at, color=style.GREY if heavy else "#e3e5e8", linewidth=1.0 if heavy else 0.4, zorder=2)
    axes.grid(visible=False)
    draw_ends(axes, scene)
    square(axes, grid.side_m)
    axes.set_title(style.label(scene.name))


def draw_grid_maps(scenes: Sequence[Scene], grid: Grid, folder: Path, name: str, picture: bool = False) -> str:
    """Draw grid maps next to each other with a legend, and on request a picture of the first scene.

    Args:
        scenes: scenes to draw, at least one.
        grid: planning grid of the cells.
        folder: folder of the figures.
        name: name of the figure.
        picture: whether to add a rendered picture of the first scene.
    """
    count = len(scenes) + picture
    columns = min(COLUMNS, count)
    figure, panels = style.panels(-(-count // columns), columns, 3.2, 3.4)
    for axes, scene in zip(panels, scenes, strict=False):
        draw_grid_map(axes, scene, grid)
    if picture:
        axes = panels[len(scenes)]
        axes.imshow(bird_view(scenes[0]))
        axes.set_axis_off()
        axes.set_title(style.label(f"{scenes[0].name}, rendered"))
    style.blank(panels[count:])
    add_legend(figure, scenes)
    return style.save(figure, folder, name)


def add_legend(figure: Figure, scenes: Sequence[Scene], more: Mapping[str, Artist] | None = None) -> None:
    """Add the legend of scenes below a figure: start, target, and each kind of obstacle that they have.

    Args:
        figure: figure with the scenes.
        scenes: scenes that are drawn.
        more: further marks by their labels.
    """
    used = [kind for kind in KINDS if any(obstacle.kind == kind for scene in scenes for obstacle in scene.obstacles)]
    ends: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "white"}
    marks: dict[str, Artist] = {
        "start": Line2D([], [], marker="o", color=START_COLOUR, markersize=8, **ends),
        "target": Line2D([], [], marker="*", color=GOAL_COLOUR, markersize=13, **ends),
        **{kind.replace("_", " "): Patch(facecolor=KIND_COLOURS[kind]) for kind in used},
    }
    if any(obstacle.walks for scene in scenes for obstacle in scene.obstacles):
        marks["way of a walking person"] = Line2D([], [], linestyle=":", color=KIND_COLOURS["person"], linewidth=1.2)
    marks |= more or {}
    columns = max(int(figure.get_figwidth() / LEGEND_ENTRY_IN), 2)
    figure.legend(
        list(marks.values()),
        list(marks),
        loc="outside lower center",
        ncols=min(columns, len(marks)),
        handlelength=1.6,
        columnspacing=1.4,
    )


def bird_view(scene: Scene) -> np.ndarray:
    """Return a picture of the whole scene from above its southern side, `(px, px, 3)` uint8."""
    pitch = math.radians(BIRD_PITCH_DEG)
    camera = lifted_camera(BIRD_HEIGHT_M, pitch, 60.0, BIRD_PX)
    return camera.render(scene, Pose(0.0, -BIRD_AWAY_M, math.pi / 2), pitch_rad=pitch)


def square(axes: Axes, side_m: float) -> None:
    """Set axes to a square of ground around the arena's centre."""
    half = side_m / 2
    axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xlabel="east (m)", ylabel="north (m)")
    ticks = np.arange(-10, 11, 5)
    axes.set_xticks(ticks)
    axes.set_yticks(ticks)
