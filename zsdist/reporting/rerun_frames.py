"""Frames for `rerun_log`: of evaluated episodes, and of the answers of a car in training."""

import base64
import binascii
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from zsdist.agent import features
from zsdist.agent.blocks import choices
from zsdist.agent.reward_shaping import path_costs
from zsdist.common import random_streams
from zsdist.common.progress import StepProgress
from zsdist.dqn import network
from zsdist.driving.car_view import RAY_SHARES, believed_way
from zsdist.errors import WeightsError
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.drivers import Observability
from zsdist.evaluation.episodes import Moment
from zsdist.evaluation.workers import Simulation, make_runner
from zsdist.planning import shortest_path
from zsdist.reporting.attention import attended, seen_share
from zsdist.reporting.rerun_log import CarFrame, RerunLog
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Action, Level
from zsdist.vision.rays import quantile_m


def record(
    contender: Contender, scenes: Sequence[Scene], seed: int, file: Path, simulation: Simulation | None = None
) -> None:
    """Drive scenes again, as the evaluation with this seed does, and record each decision into a file.

    Args:
        contender: contender that drives.
        scenes: scenes in the order of the evaluation.
        seed: seed of the evaluation.
        file: file to write, an `.rrd`.
        simulation: simulation to drive in; None: physics and the camera.

    Raises:
        RunError: Rerun is not installed, or the file cannot be written.
    """
    with RerunLog(file) as log:
        simulation = simulation or Simulation()
        runner = make_runner(contender, simulation, images=True)
        sees = contender.observability is Observability.CAMERA
        visual_act = simulation.load_vision(contender.config) if sees else None
        for index, scene in enumerate(scenes):
            path: list[tuple[float, float]] = []
            title = f"recording {index + 1} of {len(scenes)}, {scene.name}: actions"
            with StepProgress(title, contender.config.sim.max_steps) as driven:

                def on_moment(
                    moment: Moment,
                    index: int = index,
                    path: list[tuple[float, float]] = path,
                    driven: StepProgress = driven,
                ) -> None:
                    log.add(frame_of_moment(moment, contender, visual_act, path, f"{index} {moment.scene.name}"))
                    path.append(moment.observed.pose[:2])
                    driven.step()

                runner.drive(scene, random_streams.evaluated_episode(seed, index), on_moment)


def frame_of_moment(
    moment: Moment, contender: Contender, visual_act: Any, path: Sequence[tuple[float, float]], episode: str
) -> CarFrame:
    """Return the frame of one moment of an evaluated episode.

    Args:
        moment: moment of an episode that is driven with pictures.
        contender: contender that drives.
        visual_act: vision model; None: the driver has no camera.
        path: way driven before.
        episode: name of the episode.
    """
    scene, observed, thought = moment.scene, moment.observed, moment.thought
    pose = observed.pose
    told: dict[str, Any] = {"action": str(moment.outcome) if moment.action is None else _name(moment.action)}
    if visual_act is not None and observed.image is not None:
        bearing, distance = pose.towards(*observed.goal)
        view = visual_act(observed.image[None], np.array([bearing]), np.array([distance]))[0]
        if len(view.ray_angles_rad):
            reach = [quantile_m(view.ray_probabilities, share) for share in RAY_SHARES.values()]
            told["rays"] = list(
                zip(np.degrees(view.ray_angles_rad).tolist(), *(r.tolist() for r in reach), strict=True)
            )
        told["attention"] = _attention(visual_act, observed.image)
    if thought is not None and moment.action is not None:
        situation, decision = thought.situation, thought.decision
        cost = shortest_path.cost_to_go(situation.blocked, situation.goals, path_costs(situation.grid))
        told |= {
            "belief": _belief(situation.seen, situation.occupied),
            "subgoal": decision.subgoal,
            "way": believed_way(situation, cost),
            "shield_changed": bool(decision.shield_changed),
        }
        parameters = contender.parameters
        if parameters is not None:
            offered = choices(situation)
            state = features.high_state(situation, offered, features.measure_rooms(situation))
            values = network.apply(parameters[Level.HIGH], state[None])[0]
            told["values"] = {f"choice-{k}": float(values[k]) for k in np.flatnonzero(offered.mask).tolist()}
    boxes = np.array(scene.boxes(), np.float64).reshape(-1, 5)
    boxes[:, 4] = np.degrees(boxes[:, 4])
    return CarFrame(
        episode=episode,
        pose=(pose.x_m, pose.y_m, math.degrees(pose.heading_rad)),
        start=scene.start.pose[:2],
        goal=observed.goal,
        circles=np.asarray(scene.circles(moment.people), np.float64).reshape(-1, 3).tolist(),
        boxes=boxes.tolist(),
        path=path,
        picture=observed.image,
        **told,
    )


def frame_of_view(view: Mapping[str, Any]) -> CarFrame | None:
    """Return the frame of a car in training, from the answer to `view/{actor}/{car}`; None where it decided nothing.

    Args:
        view: fields of `zsdist.driving.car_view.detail`, and of `zsdist.web.attention` where there is attention.
    """
    if "decided_at" not in view:
        return None
    told: dict[str, Any] = {}
    picture = _picture(view.get("picture"))
    if (rays := view.get("rays")) and rays["angles_deg"]:
        told["rays"] = list(zip(rays["angles_deg"], *(rays[name] for name in RAY_SHARES), strict=True))
    if (looks := view.get("attention")) and picture is not None:
        weights, seen = np.array(looks["weights"], np.float64), np.array(looks["seen"], np.float64)
        told["attention"] = _attended(picture, weights, seen)
    if belief := view.get("belief"):
        size = int(belief["size"])
        told["belief"] = _belief(*(_flags(belief[name], size) for name in ("seen", "occupied")))
    x, y, heading = view["decided_at"]
    return CarFrame(
        episode=f"{view['kind']} {view['number']} {view['scene']}",
        pose=(x, y, heading),
        start=view["start"],
        goal=view["goal"],
        circles=view["circles"],
        boxes=view["boxes"],
        path=view["path"][:-1],
        way=view.get("way", ()),
        subgoal=view.get("subgoal"),
        picture=picture,
        values={_choice(choice): float(choice["value"]) for choice in view.get("choices", ())},
        action=f"{view.get('action', '')}, by {view.get('behaviour', '')}",
        shield_changed=bool(view.get("shield_changed")),
        **told,
    )


def _name(action: int) -> str:
    return Action(action).name.lower()


def _choice(choice: Mapping[str, Any]) -> str:
    return "goal" if choice["goal"] else "block-{}-{}".format(*choice["block"])


def _attention(visual_act: Any, image: np.ndarray) -> np.ndarray | None:
    """Return a picture with its attention; None for networks that have none."""
    try:
        weights = visual_act.observe(image[None]).attention[0]
    except (AttributeError, WeightsError):
        return None
    return _attended(image, weights, seen_share(visual_act.read(image[None]).clearance)[0])


def _attended(picture: np.ndarray, weights: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return a picture with the attention of all directions, each as faint as nothing is believed to be there."""
    field = (weights / weights.max(axis=1, keepdims=True) * seen[:, None]).max(axis=0)
    side = round(len(field) ** 0.5)
    return attended(picture, field.reshape(side, side), float(seen.max()))


def _belief(seen: np.ndarray, occupied: np.ndarray) -> np.ndarray:
    return np.where(occupied, 2, np.where(seen, 1, 0)).astype(np.uint8)


def _flags(bits: str, size: int) -> np.ndarray:
    packed = np.frombuffer(base64.b64decode(bits), np.uint8)
    return np.unpackbits(packed, count=size * size).reshape(size, size).astype(bool)


def _picture(content: object) -> np.ndarray | None:
    from PIL import Image

    if not isinstance(content, str):
        return None
    try:
        with Image.open(io.BytesIO(base64.b64decode(content)), formats=["JPEG"]) as image:
            return np.asarray(image.convert("RGB"))
    except (OSError, binascii.Error):
        return None
