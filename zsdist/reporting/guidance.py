"""Fig. 10: values of the high level's network over the blocks, and the driven path."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.patheffects import withStroke

from zsdist.agent import features
from zsdist.agent.blocks import GOAL_CHOICE, NEIGHBOURS, choices
from zsdist.agent.reward_shaping import path_costs
from zsdist.agent.situation import Situation, Tries
from zsdist.config import Config
from zsdist.dqn import network
from zsdist.evaluation.drivers import ViewPredictor
from zsdist.planning import forward_search
from zsdist.planning.grid import HEADINGS, STEPS
from zsdist.reporting import style
from zsdist.reporting.maps import DrivenPath, add_legend, draw_ends, draw_path, draw_scene, square
from zsdist.sim.scenes.scene import Scene
from zsdist.types import LatticeState, Parameters, Pose
from zsdist.vision.ray_ablation import ablate_rays

COLOURS = "viridis"
ARROW_SHARE = 0.36  # half the length of an arrow, as a share of a block's side
ARROW = {"arrowstyle": "-|>,head_width=0.3,head_length=0.55", "linewidth": 2.0, "color": style.BLACK}
ARROW |= {"shrinkA": 0, "shrinkB": 0}


@dataclass(frozen=True)
class Guidance:
    """Values of the high level over the blocks.

    Attributes:
        pull: `(blocks, blocks)` `[by, bx]`, value of the best choice minus the mean value of all allowed choices;
            NaN where a block is not known to be reachable.
        towards: `(blocks, blocks, 2)` unit vector to the best choice; NaN as above.
    """

    pull: np.ndarray
    towards: np.ndarray


@dataclass(frozen=True)
class Drive:
    """Driven scene, with the guidance on the map that was known at the end of the drive."""

    scene: Scene
    path: DrivenPath
    guidance: Guidance


def guidance_of(
    config: Config,
    parameters: Parameters,
    known: Situation,
    picture: Callable[[Pose], np.ndarray],
    visual_act: ViewPredictor,
) -> Guidance:
    """Return the values of the network for a car that starts in each block with the known map.

    The car is placed on the cell nearest to the block's middle that is believed to be reachable, in each of the eight
    headings, with the true picture from there and without any visits. The values of its choices are computed for each.
    The result is the advantage of one choice over the others, not the values themselves: the level is rewarded for
    progress, and more progress remains far from the goal, so the values themselves fall towards the goal.

    Args:
        config: configuration of the run.
        parameters: weights of the high level's network.
        known: last situation of a drive.
        picture: returns the camera's picture for a car at a pose.
        visual_act: vision model.
    """
    grid = known.grid
    shape = (grid.blocks, grid.blocks)
    pull, towards = np.full(shape, np.nan), np.full((*shape, 2), np.nan)
    for by in range(grid.blocks):
        for bx in range(grid.blocks):
            cell = _cell_of(known, bx, by)
            if cell is None:
                continue
            states = [LatticeState(*cell, heading) for heading in range(HEADINGS)]
            poses = [grid.pose(state) for state in states]
            images = np.stack([picture(pose) for pose in poses])
            bearings, distances = zip(*(pose.towards(*known.goal) for pose in poses), strict=True)
            views = visual_act(images, np.array(bearings), np.array(distances))
            advices = [ablate_rays(view, config.vision.rays).advice for view in views]
            situations = [_started_at(known, state, advice) for state, advice in zip(states, advices, strict=True)]
            pull[by, bx], towards[by, bx] = _best_choice(situations, parameters)
    return Guidance(pull, towards)


def draw_guidance(drives: Sequence[Drive], config: Config, folder: Path) -> str:
    """Draw values and directions over the blocks and, next to them, the path; one row per scene."""
    figure, panels = style.panels(len(drives), 2, 3.9, 3.6)
    for (left, right), drive in zip(zip(panels[::2], panels[1::2], strict=True), drives, strict=True):
        mesh = _draw_values(left, drive, config)
        figure.colorbar(mesh, ax=left, label="Q of the best choice minus mean Q", shrink=0.85, pad=0.02)
        draw_scene(right, drive.scene, config.grid.arena_m)
        _draw_blocks(right, config)
        draw_path(right, drive.path)
        right.legend(loc="lower right", frameon=True, framealpha=0.85, edgecolor="none", fontsize=7)
    add_legend(figure, [drive.scene for drive in drives])
    return style.save(figure, folder, "fig10-guidance")


def _draw_values(axes: Axes, drive: Drive, config: Config) -> AxesImage:
    guidance, half = drive.guidance, config.grid.cells * config.grid.cell_size_m / 2
    side = 2 * half / config.grid.blocks
    values = np.ma.masked_invalid(guidance.pull)
    axes.set_facecolor(style.PALE)
    mesh = axes.imshow(values, origin="lower", extent=(-half, half, -half, half), cmap=COLOURS, vmin=0.0)
    _draw_blocks(axes, config)
    axes.grid(visible=False)
    for by, bx in zip(*np.nonzero(~np.isnan(guidance.pull)), strict=True):
        middle = (-half + (bx + 0.5) * side, -half + (by + 0.5) * side)
        step = guidance.towards[by, bx] * side * ARROW_SHARE
        ends = (middle[0] - step[0], middle[1] - step[1]), (middle[0] + step[0], middle[1] + step[1])
        arrow = axes.annotate("", ends[1], ends[0], arrowprops=ARROW, zorder=5)
        assert arrow.arrow_patch is not None, "an annotation with `arrowprops` has an arrow"
        arrow.arrow_patch.set_path_effects([withStroke(linewidth=4.5, foreground="white")])
    draw_ends(axes, drive.scene)
    square(axes, 2 * half)
    axes.set_title("guidance over the blocks")
    return mesh


def _draw_blocks(axes: Axes, config: Config) -> None:
    half = config.grid.cells * config.grid.cell_size_m / 2
    for at in np.linspace(-half, half, config.grid.blocks + 1):
        axes.plot([at, at], [-half, half], color=style.GREY, linewidth=0.9, zorder=0.9)
        axes.plot([-half, half], [at, at], color=style.GREY, linewidth=0.9, zorder=0.9)


def _cell_of(known: Situation, bx: int, by: int) -> tuple[int, int] | None:
    """Return the cell nearest to a block's middle that is believed to be reachable; None where there is none."""
    grid = known.grid
    rows, columns = grid.block_cells(bx, by)
    ys, xs = np.nonzero(known.reachable[rows, columns])
    if not len(xs):
        return None
    middle = (grid.block_size - 1) / 2
    nearest = int(np.hypot(xs - middle, ys - middle).argmin())
    return int(columns.start + xs[nearest]), int(rows.start + ys[nearest])


def _started_at(known: Situation, state: LatticeState, advice: np.ndarray) -> Situation:
    """Return the situation of a car that starts in `state` with the same map and no visits."""
    return replace(
        known,
        state=state,
        advice=advice,
        drive_m=forward_search.path_lengths_from(known.blocked, state, path_costs(known.grid)),
        visits=np.zeros_like(known.visits),
        block_visits=np.zeros_like(known.block_visits),
        tries=Tries.none(known.grid),
    )


def _best_choice(situations: Sequence[Situation], parameters: Parameters) -> tuple[float, np.ndarray]:
    """Return the advantage of the choice with the highest mean value over the mean of all choices, and its direction.

    Choices are identified by their target in the world: the eight neighbouring blocks, and the goal. Only allowed
    choices count.
    """
    offered = [choices(situation) for situation in situations]
    states = np.stack(
        [
            features.high_state(situation, options, features.measure_rooms(situation))
            for situation, options in zip(situations, offered, strict=True)
        ]
    )
    values = np.where(np.stack([options.mask for options in offered]), network.apply(parameters, states), np.nan)
    world = np.full_like(values, np.nan)
    for row, situation in enumerate(situations):
        turned = (np.arange(NEIGHBOURS) + situation.state.heading) % HEADINGS
        world[row, turned] = values[row, :NEIGHBOURS]
        world[row, GOAL_CHOICE] = values[row, GOAL_CHOICE]
    means = np.array([np.nanmean(column) if np.isfinite(column).any() else np.nan for column in world.T])
    best = int(np.nanargmax(means))
    if best == GOAL_CHOICE:
        x, y = situations[0].position
        step = np.array([situations[0].goal[0] - x, situations[0].goal[1] - y])
    else:
        step = STEPS[best].astype(float)
    return float(means[best] - np.nanmean(means)), step / max(math.hypot(*step), 1e-9)
