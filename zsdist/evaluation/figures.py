"""Pictures of a run or an evaluation, as PNG files: paths seen from above, and curves over episodes."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.transforms import Affine2D

from zsdist.sim.kinds import GROUNDS, KINDS
from zsdist.sim.scene import Scene
from zsdist.types import Outcome

matplotlib.use("Agg")

COLOURS = {Outcome.SUCCESS: "tab:green", Outcome.COLLISION: "tab:red", Outcome.TIMEOUT: "tab:orange"}
COLUMNS = 3


@dataclass(frozen=True)
class Track:
    """One driven path: `points` `(n, 2)` metres, how it ended, and whose it is."""

    points: np.ndarray
    outcome: Outcome
    label: str


def draw_paths(panels: Sequence[tuple[Scene, Sequence[Track]]], arena_m: float, file: Path) -> None:
    """Scenes from above with the paths driven in them; a path's colour is its outcome, its style whose it is.

    Args:
        panels: a scene and its tracks each, at least one.
        arena_m: side of the arena.
        file: PNG to write.
    """
    rows = -(-len(panels) // COLUMNS)
    figure = Figure(figsize=(4 * COLUMNS, 4.2 * rows), layout="constrained")
    grid = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes, (scene, tracks) in zip(grid, panels, strict=False):
        _draw_scene(axes, scene, arena_m)
        for style, track in zip(("-", "--", ":", "-.") * len(tracks), tracks, strict=False):
            label = f"{track.label}: {track.outcome}" if track.label else str(track.outcome)
            axes.plot(*np.asarray(track.points).T, style, color=COLOURS[track.outcome], linewidth=1.6, label=label)
        axes.legend(fontsize=6, loc="lower right")
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    figure.savefig(file, dpi=110)


def draw_curves(episodes: Sequence[dict[str, Any]], window: int, file: Path) -> None:
    """Return and share of successes over the episodes of a run, each as it was and as the mean of the last `window`.

    Args:
        episodes: objects of `episodes.jsonl` in their order, with `return` and `outcome`; at least one.
        window: episodes of the running mean.
        file: PNG to write.
    """
    returns = np.array([episode["return"] for episode in episodes], dtype=float)
    successes = np.array([episode["outcome"] == Outcome.SUCCESS for episode in episodes], dtype=float)
    numbers = np.arange(1, len(episodes) + 1)
    figure = Figure(figsize=(8, 6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    upper.plot(numbers, returns, ".", color="tab:blue", alpha=0.35, markersize=4, label="an episode")
    upper.plot(numbers, running_mean(returns, window), color="tab:blue", label=f"mean of the last {window}")
    upper.set_ylabel("return (the paper's reward)")
    upper.legend(fontsize=8)
    lower.plot(numbers, running_mean(successes, window), color="tab:green", label="success")
    for outcome in (Outcome.COLLISION, Outcome.TIMEOUT):
        share = np.array([episode["outcome"] == outcome for episode in episodes], dtype=float)
        lower.plot(numbers, running_mean(share, window), color=COLOURS[outcome], linewidth=1, label=str(outcome))
    lower.set_ylabel(f"share of the last {window}")
    lower.set_xlabel("finished episodes")
    lower.set_ylim(-0.02, 1.02)
    lower.legend(fontsize=8)
    figure.savefig(file, dpi=110)


def running_mean(values: np.ndarray, window: int) -> np.ndarray:
    """Mean of each value and up to `window - 1` before it, `(n,)`."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - window, 0)
    return (sums[ends] - sums[starts]) / (ends - starts)


def _draw_scene(axes: Axes, scene: Scene, arena_m: float) -> None:
    axes.set_facecolor((*GROUNDS[scene.ground].base_colour, 0.35))
    for obstacle in scene.obstacles:
        colour = KINDS[obstacle.kind].base_colour
        if obstacle.radius_m is not None:
            axes.add_patch(Circle((obstacle.x_m, obstacle.y_m), obstacle.radius_m, color=colour))
            if obstacle.walks:
                axes.plot(*np.array(obstacle.path).T, ":", color=colour, linewidth=1)
        else:
            length, width, _ = obstacle.size_m
            turn = Affine2D().rotate_deg(obstacle.heading_deg).translate(obstacle.x_m, obstacle.y_m)
            body = Rectangle((-length / 2, -width / 2), length, width, color=colour)
            body.set_transform(turn + axes.transData)
            axes.add_patch(body)
    axes.plot(scene.start.x_m, scene.start.y_m, "o", color="black", markersize=6, label="start")
    axes.plot(*scene.goal, "*", color="gold", markeredgecolor="black", markersize=12, label="goal")
    half = arena_m / 2
    axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
    axes.set_title(scene.name, fontsize=9)
    axes.tick_params(labelsize=7)
