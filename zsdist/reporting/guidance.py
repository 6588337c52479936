"""Fig. 10: what the high level's network makes of each block, and the path that was driven."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from zsdist.agent import features
from zsdist.agent.blocks import GOAL_CHOICE, NEIGHBOURS, choices
from zsdist.agent.reward_shaping import way_costs
from zsdist.agent.situation import Situation
from zsdist.config import Config
from zsdist.dqn import network
from zsdist.evaluation.drivers import VisualAct
from zsdist.planning import forward_search
from zsdist.planning.grid import HEADINGS, STEPS
from zsdist.reporting import style
from zsdist.reporting.maps import DrivenPath, draw_ends, draw_scene, draw_track, square
from zsdist.sim.scenes.scene import Scene
from zsdist.types import LatticeState, Parameters, Pose
from zsdist.vision.ray_ablation import ablate_rays

COLOURS = "viridis"
ARROW_SHARE = 0.36  # of a block's side
ARROW = {"arrowstyle": "-|>,head_width=0.3,head_length=0.55", "linewidth": 2.0, "color": style.BLACK}
ARROW |= {"shrinkA": 0, "shrinkB": 0}


@dataclass(frozen=True)
class Guidance:
    """The high level's values over the blocks.

    Attributes:
        pull: `(blocks, blocks)` `[by, bx]`: by how much the most valued choice exceeds the mean of those that can be
            made; NaN where no known way leads.
        towards: `(blocks, blocks, 2)` unit vector to the most valued choice; NaN as above.
    """

    pull: np.ndarray
    towards: np.ndarray


@dataclass(frozen=True)
class Drive:
    """A driven scene with the guidance on the map as it was known at the end."""

    scene: Scene
    track: DrivenPath
    guidance: Guidance


def guidance_of(
    config: Config,
    parameters: Parameters,
    known: Situation,
    picture: Callable[[Pose], np.ndarray],
    visual_act: VisualAct,
) -> Guidance:
    """What the network would value if the car began anew in each block, with the map it has.

    The car is put on the cell next to the block's middle to which a free way is believed to lead, in each of the eight
    headings, with the true picture from there and no memory of visits. From each the values of its choices are asked.
    Shown is how much one choice is better than the others, not the values themselves: the level learns from progress,
    of which more is to be made from afar, so its values fall towards the goal.

    Args:
        config: of the run.
        parameters: of the high level's network.
        known: the last situation of a drive.
        picture: what the camera of a car at a pose shows.
        visual_act: reads the pictures.
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
            asked = [_anew(known, state, advice) for state, advice in zip(states, advices, strict=True)]
            pull[by, bx], towards[by, bx] = _judge(asked, parameters)
    return Guidance(pull, towards)


def draw_guidance(drives: Sequence[Drive], config: Config, folder: Path) -> str:
    """Values and directions over the blocks, and beside them the path; a row a scene."""
    figure, panels = style.panels(len(drives), 2, 3.9, 3.6)
    for (left, right), drive in zip(zip(panels[::2], panels[1::2], strict=True), drives, strict=True):
        mesh = _draw_values(left, drive, config)
        figure.colorbar(mesh, ax=left, label="best choice over the mean of all (Q)", shrink=0.85, pad=0.02)
        draw_scene(right, drive.scene, config.grid.arena_m)
        _draw_blocks(right, config)
        draw_track(right, drive.track)
        right.legend(loc="lower right", frameon=True, framealpha=0.85, edgecolor="none", fontsize=7)
    return style.save(figure, folder, "fig10-guidance")


def _draw_values(axes: Axes, drive: Drive, config: Config) -> object:
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
    """The cell next to a block's middle that can be reached as far as is known."""
    grid = known.grid
    rows, columns = grid.block_cells(bx, by)
    ys, xs = np.nonzero(known.reachable[rows, columns])
    if not len(xs):
        return None
    middle = (grid.block_size - 1) / 2
    nearest = int(np.hypot(xs - middle, ys - middle).argmin())
    return int(columns.start + xs[nearest]), int(rows.start + ys[nearest])


def _anew(known: Situation, state: LatticeState, advice: np.ndarray) -> Situation:
    """The same map with the car elsewhere and nothing visited yet."""
    return replace(
        known,
        state=state,
        advice=advice,
        drive_m=forward_search.metres_from(known.blocked, state, way_costs(known.grid)),
        visits=np.zeros_like(known.visits),
        block_visits=np.zeros_like(known.block_visits),
        tries=np.zeros_like(known.tries),
        goal_tries=0,
    )


def _judge(situations: Sequence[Situation], parameters: Parameters) -> tuple[float, np.ndarray]:
    """By how much the choice that is valued most on average exceeds the mean of all, and its direction.

    Choices are told apart by where they lead in the world: the eight neighbours, and the goal. Only those that can be
    made count.
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
        x, y = situations[0].place
        step = np.array([situations[0].goal[0] - x, situations[0].goal[1] - y])
    else:
        step = STEPS[best].astype(float)
    return float(means[best] - np.nanmean(means)), step / max(math.hypot(*step), 1e-9)
