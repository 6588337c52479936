"""Figures of a trained vision model: JPEG files if they show pictures of the camera, else PNG."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from zsdist.reporting.attention import overlay
from zsdist.vision.labels import DIRECTIONS
from zsdist.vision.rays import BIN_EDGES_M, RANGE_M

matplotlib.use("Agg")

TRUE_COLOUR, PREDICTED_COLOUR = "#18b66a", "#ff2e88"
TRAINING_COLOUR, VALIDATION_COLOUR = "#9aa5b1", "#1f5fa8"
ACTION_TITLES = tuple(f"{name} ($I_{number}$)" for number, name in enumerate(DIRECTIONS, 1))
CONFUSION_EDGES_M = BIN_EDGES_M[::2]  # a bin of the heat map spans two bins of the distributions
_TICKS_M = (0.25, 0.5, 1.0, 2.0, 4.0)
_DPI = 130
_JPEG_QUALITY = 90  # quality of figures made of pictures: a quarter of the size of a PNG


@dataclass(frozen=True)
class Miss:
    """Picture with missed rays.

    Attributes:
        image: `(px, px, 3)` uint8.
        true_m: `(R,)`, true distances, at most the camera's range.
        predicted_m: `(R,)`, predicted distances, at most the camera's range.
        worst: index of the ray whose prediction exceeds the true distance most.
        title: title of the picture's set.
    """

    image: np.ndarray
    true_m: np.ndarray
    predicted_m: np.ndarray
    worst: int
    title: str


def draw_losses(history: Sequence[Mapping[str, Any]], file: Path) -> None:
    """Draw the loss over the epochs in training and validation, one panel per stage (Fig. 5 of the paper).

    Args:
        history: objects of `training.jsonl`, one or more.
        file: PNG to write.
    """
    stages = list(dict.fromkeys(line["stage"] for line in history))
    figure = Figure(figsize=(4.0 * len(stages), 3.3), layout="constrained")
    panels = figure.subplots(1, len(stages), squeeze=False)[0]
    for axes, stage in zip(panels, stages, strict=True):
        lines = [line for line in history if line["stage"] == stage]
        epochs = [line["epoch"] for line in lines]
        for key, colour, label in (
            ("loss", TRAINING_COLOUR, "training"),
            ("validation_loss", VALIDATION_COLOUR, "validation"),
        ):
            axes.plot(epochs, [line[key] for line in lines], color=colour, linewidth=1.8, label=label)
        best = min(lines, key=lambda line: line["validation_loss"])
        axes.plot(best["epoch"], best["validation_loss"], "o", color=VALIDATION_COLOUR, label="kept")
        axes.set(title=stage, xlabel="epoch")
        axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        _plain(axes)
    panels[0].set_ylabel("loss")
    panels[-1].legend(frameon=False, fontsize=8)
    _save(figure, file)


def draw_attention(
    images: Sequence[np.ndarray], attention: np.ndarray, seen: np.ndarray, titles: Sequence[str], file: Path
) -> None:
    """Draw the attention of each action on pictures: one row per picture, the picture itself first.

    It is faint, and said so, where the network believes that there is nothing to look at.

    Args:
        images: N pictures `(px, px, 3)` uint8.
        attention: `(N, 3, side * side)`, attention of each action.
        seen: `(N, 3)`, probability that something is within range in the direction of each action.
        titles: title of each picture.
        file: JPEG to write.
    """
    side = round(attention.shape[-1] ** 0.5)
    figure = Figure(figsize=(8.4, 2.15 * len(images) + 0.3), layout="constrained")
    panels = figure.subplots(len(images), 4, squeeze=False)
    for row, image, maps, shares, title in zip(panels, images, attention, seen, titles, strict=True):
        px = len(image)
        row[0].imshow(image)
        row[0].set_ylabel(title, fontsize=8)
        grey = image.mean(-1)
        for axes, weights, share in zip(row[1:], maps, shares, strict=True):
            axes.imshow(grey, cmap="gray", vmin=0, vmax=330)
            axes.imshow(overlay(weights.reshape(side, side), px, float(share)), extent=(0, px, px, 0))
            if share < 0.5:
                note = f"nothing within {RANGE_M:g} m: {1 - share:.0%}"
                axes.text(0.5, 0.04, note, transform=axes.transAxes, ha="center", fontsize=7)
    for axes, title in zip(panels[0], ("picture", *ACTION_TITLES), strict=True):
        axes.set_title(title, fontsize=9, parse_math=True)
    for axes in panels.ravel():
        _frame_only(axes)
    _save(figure, file)


def confusion(true_m: np.ndarray, predicted_m: np.ndarray, edges_m: np.ndarray = CONFUSION_EDGES_M) -> np.ndarray:
    """Return the confusion of true and predicted distances, `(bins, bins)`; the last bin means "free".

    A row is a true bin. It holds the shares of the predicted bins and sums to 1, or to 0 if the true bin is empty.

    Args:
        true_m: true distances in metres, at most the range.
        predicted_m: predicted distances of the same shape.
        edges_m: increasing edges, the last one the range; distances below the first one count into the first bin.
    """
    bins = len(edges_m)
    true = np.clip(np.searchsorted(edges_m, true_m.ravel(), side="right") - 1, 0, bins - 1)
    predicted = np.clip(np.searchsorted(edges_m, predicted_m.ravel(), side="right") - 1, 0, bins - 1)
    counts = np.bincount(true * bins + predicted, minlength=bins * bins).reshape(bins, bins)
    return counts / np.maximum(counts.sum(1, keepdims=True), 1)


def draw_confusion(panels: Mapping[str, tuple[np.ndarray, np.ndarray]], file: Path) -> None:
    """Draw predicted against true distance as heat maps, one column per true distance.

    Args:
        panels: true and predicted distances in metres, by title.
        file: PNG to write.
    """
    figure = Figure(figsize=(4.1 * len(panels) + 0.6, 4.1), layout="constrained")
    grid = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
    edges = np.append(CONFUSION_EDGES_M, RANGE_M * CONFUSION_EDGES_M[1] / CONFUSION_EDGES_M[0])
    for axes, (title, (true_m, predicted_m)) in zip(grid, panels.items(), strict=True):
        shares = confusion(true_m, predicted_m)
        mesh = axes.pcolormesh(edges, edges, shares.T, cmap="Blues", norm=PowerNorm(0.5, 0, 1))
        axes.plot(edges, edges, color="black", linewidth=0.6, alpha=0.5)
        axes.set(xscale="log", yscale="log", aspect="equal", xlabel="true distance (m)")
        axes.set_title(title, fontsize=9)
        _distance_ticks(axes, edges)
    grid[0].set_ylabel("predicted distance (m)")
    figure.colorbar(mesh, ax=list(grid), label="share of the column", shrink=0.8, ticks=(0, 0.01, 0.05, 0.2, 0.5, 1))
    _save(figure, file)


def draw_reliability(curves: Mapping[str, tuple[np.ndarray, np.ndarray]], file: Path) -> None:
    """Draw how often the truth lies under each quantile, one panel per set; the diagonal is ideal.

    Args:
        curves: quantiles, and the shares of true distances under them, by title.
        file: PNG to write.
    """
    columns = min(4, len(curves))
    rows = -(-len(curves) // columns)
    figure = Figure(figsize=(2.4 * columns, 2.6 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, (title, (shares, under)) in zip(grid.ravel(), curves.items(), strict=False):
        axes.plot([0, 1], [0, 1], color="black", linewidth=0.7, alpha=0.5)
        axes.plot(shares, under, color=VALIDATION_COLOUR, linewidth=1.8, marker="o", markersize=3)
        axes.set_title(title, fontsize=9)
        axes.set(xlim=(0, 1), ylim=(0, 1), aspect="equal", xticks=(0, 0.5, 1), yticks=(0, 0.5, 1))
        _plain(axes)
        axes.tick_params(labelbottom=True)
    for axes in grid.ravel()[len(curves) :]:
        axes.set_axis_off()
    figure.supxlabel("quantile", fontsize=10)
    figure.supylabel("share of rays with the truth under it", fontsize=10)
    _save(figure, file)


def draw_misses(misses: Sequence[Miss], field_of_view_rad: float, camera_height_m: float, file: Path) -> None:
    """Draw pictures with the ends of the rays on the ground, and below each the true and predicted distances.

    Args:
        misses: pictures with missed rays, one or more.
        field_of_view_rad: field of view of the level camera.
        camera_height_m: height of the camera above the ground.
        file: JPEG to write.
    """
    columns = min(4, len(misses))
    rows = -(-len(misses) // columns)
    figure = Figure(figsize=(2.5 * columns, 3.7 * rows), layout="constrained")
    grid = figure.subplots(2 * rows, columns, squeeze=False, height_ratios=[2.5, 1] * rows)
    for number, miss in enumerate(misses):
        row, column = divmod(number, columns)
        picture, profile, px = grid[2 * row, column], grid[2 * row + 1, column], len(miss.image)
        picture.imshow(miss.image)
        for distance, colour, label in (
            (miss.true_m, TRUE_COLOUR, "true"),
            (miss.predicted_m, PREDICTED_COLOUR, "predicted"),
        ):
            across, down = feet_px(distance, px, field_of_view_rad, camera_height_m)
            picture.plot(across, np.where(distance < RANGE_M, down, np.nan), color=colour, linewidth=2)
            profile.plot(across, distance, color=colour, linewidth=1.6, drawstyle="steps-mid", label=label)
        for axes, colour in ((picture, "white"), (profile, "black")):
            axes.axvline(across[miss.worst], color=colour, linewidth=0.8, linestyle=":")
        true_m, predicted_m = miss.true_m[miss.worst], miss.predicted_m[miss.worst]
        picture.set_title(f"{miss.title}\ntrue {true_m:.1f} m, predicted {_distance(predicted_m)}", fontsize=8)
        picture.set(xlim=(0, px), ylim=(px, 0))
        _frame_only(picture)
        profile.set(xlim=(0, px), ylim=(0, 1.06 * RANGE_M), xticks=[], yticks=(0, RANGE_M / 2, RANGE_M))
        _plain(profile)
        if column == 0:
            profile.set_ylabel("distance (m)", fontsize=8)
    for axes in grid.reshape(rows, 2, columns).transpose(0, 2, 1).reshape(-1, 2)[len(misses) :].ravel():
        axes.set_axis_off()
    grid[1, 0].legend(frameon=False, fontsize=7, loc="upper right", bbox_to_anchor=(1.0, 0.95))
    _save(figure, file)


def feet_px(
    distance_m: np.ndarray, px: int, field_of_view_rad: float, camera_height_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixel positions of the rays' ends on the ground, from the left and from the top, `(R,)` each.

    Args:
        distance_m: `(R,)` horizontal distances of rays that divide the picture's columns evenly, from the left.
        px: side of the picture in pixels.
        field_of_view_rad: field of view of the level camera.
        camera_height_m: height of the camera above the ground.
    """
    rays = len(distance_m)
    across = (np.arange(rays) + 0.5) * px / rays
    tangent = np.tan(field_of_view_rad / 2)
    slope = tangent * (1 - 2 * across / px)
    depth_m = np.maximum(distance_m, 1e-3) / np.sqrt(1 + slope**2)
    down = px / 2 * (1 + camera_height_m / (depth_m * tangent))
    return across, np.minimum(down, px)


def _save(figure: Figure, file: Path) -> None:
    quality = {"quality": _JPEG_QUALITY, "subsampling": 0} if file.suffix == ".jpg" else {}
    figure.savefig(file, dpi=_DPI, bbox_inches="tight", pad_inches=0.08, pil_kwargs=quality)


def _distance(metres: float) -> str:
    return "free" if metres >= RANGE_M else f"{metres:.1f} m"


def _distance_ticks(axes: Axes, edges: np.ndarray) -> None:
    """Label both axes with distances, and the last bin with "free"."""
    free = float(np.sqrt(edges[-2] * edges[-1]))
    names = {**{tick: f"{tick:g}" for tick in _TICKS_M}, free: "free"}
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(FixedLocator(list(names)))
        axis.set_minor_locator(FixedLocator([]))
        axis.set_major_formatter(FuncFormatter(lambda value, _: names.get(value, "")))
    axes.tick_params(labelsize=8, length=2)


def _plain(axes: Axes) -> None:
    """Remove the upper and right edge, and draw a light grid."""
    for edge in ("top", "right"):
        axes.spines[edge].set_visible(False)
    axes.tick_params(labelsize=8, length=2)
    axes.grid(color="black", alpha=0.08, linewidth=0.6)


def _frame_only(axes: Axes) -> None:
    """Remove ticks and edges."""
    axes.set(xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_visible(False)
