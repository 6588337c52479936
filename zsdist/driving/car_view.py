"""Views of cars that drive, for watchers: where they are, and what one of them sees, believes and seeks.

It is read from the car when somebody asks, changes nothing, and draws nothing from the car's random numbers. Poses are
`[x_m, y_m, heading_deg]` and points `[x_m, y_m]`, with the origin in the middle of the arena.
"""

import base64
import io
import math
from typing import Any

import numpy as np

from zsdist.agent.blocks import GOAL_CHOICE
from zsdist.agent.epsilon_greedy import QFunction
from zsdist.agent.hierarchy import HierarchicalAgent
from zsdist.agent.reward_shaping import path_costs
from zsdist.agent.situation import Situation
from zsdist.config import Config
from zsdist.driving.actor_car import ActorCar, Glance
from zsdist.planning import shortest_path
from zsdist.planning.grid import HEADINGS
from zsdist.types import Pose
from zsdist.vision.rays import quantile_m

Fields = dict[str, Any]
JPEG_QUALITY = 88
RAY_SHARES = {"near_m": 0.1, "median_m": 0.5, "far_m": 0.9}  # quantiles of the distances along rays
LEAST_CELLS = 6  # reachable cells of a block, below which its gradient says nothing


def overview(car: ActorCar) -> Fields:
    """Return where a car is and what it drives: a few hundred bytes as JSON."""
    if car.idle:
        return {"kind": "idle"}
    task, episode = car.task, car.episode
    return {
        "kind": "training" if task.trains else task.candidate,
        "number": task.number,
        "step": len(episode.rewards),
        "scene": str(task.scene.name),
        "outcome": "" if episode.outcome is None else episode.outcome.value,
        "pose": _pose(episode.pose),
        "start": _point(episode.poses[0]),
        "goal": _point(episode.goal),
        "circles": _rounded(task.scene.circles(), 1),
        "boxes": _boxes(task.scene.boxes()),
    }


def detail(car: ActorCar, config: Config, q: QFunction | None) -> Fields:
    """Return what a car sees, believes and seeks, as of its last decision.

    Args:
        car: car, which may be idle.
        config: configuration of the run.
        q: Q-function of the high level that drives the car; None where the car is idle.
    """
    fields = overview(car)
    if car.idle or q is None:
        return fields
    fields |= {
        "arena_m": config.grid.arena_m,
        "path": [_point(pose) for pose in car.episode.poses],
        "epsilon": round(car.task.epsilon, 3),
        "shielded": car.task.shielded,
    }
    if car.glance is not None:
        fields |= _seen(car, car.glance, config) | _thought(car.agent, car.glance, q)
    return fields


def _seen(car: ActorCar, glance: Glance, config: Config) -> Fields:
    """Return picture, rays and readings of the last decision."""
    view, camera = glance.view, config.camera
    rays: Fields = {"angles_deg": _rounded(np.degrees(view.ray_angles_rad), 1)}
    for name, share in RAY_SHARES.items():
        rays[name] = _rounded(quantile_m(view.ray_probabilities, share), 2) if len(view.ray_angles_rad) else []
    return {
        "decided_at": _pose(glance.pose),
        "picture": _jpeg(car.picture(glance.pose)),
        "camera": {
            "field_of_view_deg": camera.field_of_view_deg,
            "height_m": camera.height_m,
            "forward_m": camera.forward_m,
            "range_m": camera.range_m,
        },
        "rays": rays,
        "clearance_m": _rounded(view.clearance_m, 2),
        "dynamic": _rounded(view.dynamic, 2),
        "advice": _rounded(view.advice, 2),
    }


def _thought(agent: HierarchicalAgent, glance: Glance, q: QFunction) -> Fields:
    """Return belief, block values and decision."""
    situation, choices, decision = agent.situation, agent.high_choices, glance.decision
    grid, values = situation.grid, agent.high_values(q)
    cost = shortest_path.cost_to_go(situation.blocked, situation.goals, path_costs(grid))
    return {
        "grid_m": grid.side_m,
        "blocks": grid.blocks,
        "belief": {
            "size": grid.fine_size,  # cells a side; bits row by row from the south-western corner, highest bit first
            "seen": _bits(situation.seen),
            "occupied": _bits(situation.occupied),
        },
        "action": decision.action.name.lower(),
        "behaviour": decision.behaviour.name.lower(),
        "shield_changed": decision.shield_changed,
        "subgoal": _point(decision.subgoal),
        "choices": [
            {"block": choices.blocks[k].tolist(), "value": round(float(values[k]), 3), "goal": k == GOAL_CHOICE}
            for k in np.flatnonzero(choices.mask).tolist()
        ],
        "gradients": _gradients(situation, cost),
        "way": believed_way(situation, cost),
    }


def _gradients(situation: Situation, cost: np.ndarray) -> list[Fields]:
    """Return for each block the direction in which the believed way to the goal becomes shorter, and its mean length.

    The direction is the steepest descent of a plane through the costs of the block's cells, at their best heading.
    """
    grid, best = situation.grid, cost.min(axis=2)
    rows, columns = np.mgrid[: grid.block_size, : grid.block_size]
    found = []
    for by in range(grid.blocks):
        for bx in range(grid.blocks):
            metres = best[grid.block_cells(bx, by)]
            finite = np.isfinite(metres)
            if np.count_nonzero(finite) < LEAST_CELLS:
                continue
            plane = np.stack([columns[finite], rows[finite], np.ones(np.count_nonzero(finite))], axis=1)
            east, north, _ = np.linalg.lstsq(plane, metres[finite].astype(np.float64), rcond=None)[0]
            steepness = math.hypot(east, north)
            if steepness > 0:
                direction = [round(-east / steepness, 3), round(-north / steepness, 3)]
                found.append({"block": [bx, by], "to": direction, "way_m": round(float(metres[finite].mean()), 1)})
    return found


def believed_way(situation: Situation, cost: np.ndarray) -> list[list[float]]:
    """Return the shortest believed way to the goal, which no network needs; empty where none leads there.

    Args:
        situation: situation of the car.
        cost: cost to go from each state of the lattice, metres.
    """
    grid, state = situation.grid, situation.state
    if not math.isfinite(cost[state.iy, state.ix, state.heading]):
        return []
    flat, _ = shortest_path.flat_path(cost, situation.blocked, state, path_costs(grid))
    cells = dict.fromkeys((flat // HEADINGS).tolist())  # each once: a turn in place stays in its cell
    return [_point(grid.centre(cell % grid.cells, cell // grid.cells)) for cell in cells]


def _jpeg(picture: np.ndarray) -> str:
    from PIL import Image  # only where somebody looks

    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "JPEG", quality=JPEG_QUALITY)
    return base64.b64encode(buffer.getvalue()).decode()


def _bits(flags: np.ndarray) -> str:
    return base64.b64encode(np.packbits(flags).tobytes()).decode()


def _pose(pose: Pose) -> list[float]:
    return [round(pose.x_m, 2), round(pose.y_m, 2), round(math.degrees(pose.heading_rad), 1)]


def _point(point: Any) -> list[float]:
    return [round(float(point[0]), 2), round(float(point[1]), 2)]


def _boxes(boxes: np.ndarray) -> list[list[float]]:
    boxes = np.array(boxes, np.float64)
    boxes[:, 4] = np.degrees(boxes[:, 4])
    return _rounded(boxes, 1)


def _rounded(values: np.ndarray, digits: int) -> list[Any]:
    rounded: list[Any] = np.round(np.asarray(values, np.float64), digits).tolist()
    return rounded
