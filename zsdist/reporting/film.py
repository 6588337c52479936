"""Films of driven episodes: the car from behind, its camera picture with attention, and its belief map."""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from zsdist.common import random_streams
from zsdist.common.progress import StepProgress
from zsdist.config import Config
from zsdist.errors import RunError, WeightsError
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.drivers import Observability
from zsdist.evaluation.episodes import Moment
from zsdist.evaluation.workers import Simulation, make_runner
from zsdist.planning.footprint import ADVANCES
from zsdist.planning.grid import Grid
from zsdist.reporting import film_file, style
from zsdist.reporting.attention import overlay, seen_share
from zsdist.reporting.belief_view import BeliefView
from zsdist.reporting.chase import ChaseCamera
from zsdist.sim.camera import make_camera
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Action, Pose
from zsdist.vision.labels import DIRECTIONS

PANEL_PX, GAP_PX, CAPTION_PX = 480, 6, 78
FRAMES_PER_ACTION = 5
# An action takes 0.45 to 1 s in the simulation, half a second here (`film_file.FRAMES_PER_SECOND`).
TURN_SHARE = 0.4  # share of frames for the turn, in an action that turns and then moves
LAST_FRAMES = 15
_WIDTH_PX = 3 * (PANEL_PX + GAP_PX) - GAP_PX
_GLOW = 0.75  # greatest share of the heat map in a picture
_DIRECTION_OF = {  # index into `DIRECTIONS`; there is one attention map for each
    Action.FORWARD: 0,
    Action.LEFT_45: 1,
    Action.TURN_LEFT_90: 1,
    Action.RIGHT_45: 2,
    Action.TURN_RIGHT_90: 2,
}
_TITLES = (
    "view from behind (not seen by the car)",
    "camera picture, attention for this action",
    "belief map; thin outlines: true obstacles",
)


def film(
    contender: Contender,
    scenes: Sequence[Scene],
    seed: int,
    folder: Path,
    on_film: Callable[[Path], None],
    simulation: Simulation | None = None,
) -> list[Path]:
    """Drive scenes again, as the evaluation with this seed does, and film each as an MP4, with progress.

    A film is whole or not there. Between decisions the poses are interpolated: first the turn, then the movement. The
    camera's pictures between decisions are rendered for a level car. Attention is that of the decision, on the picture
    that the car then saw, as faint as the network believes that nothing is within its range there, and fades while it
    moves on. It is missing for networks without attention and for drivers without a camera.

    Args:
        contender: contender that drives.
        scenes: scenes in the order of the evaluation.
        seed: seed of the evaluation.
        folder: folder of the films; made if it does not exist.
        on_film: called with each file when it is complete.
        simulation: simulation to drive in; None: physics and the camera.

    Returns:
        The films, named by number, scene and outcome; next to each film is a JPEG of its middle.

    Raises:
        RunError: the folder or a film cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"--video {folder} cannot be written: {error.strerror or error}") from error
    simulation = simulation or Simulation()
    runner = make_runner(contender, simulation, images=True)
    visual_act = simulation.load_vision(contender.config) if contender.observability is Observability.CAMERA else None
    files = []
    for index, scene in enumerate(scenes):
        moments: list[Moment] = []
        title = f"film {index + 1} of {len(scenes)}, {scene.name}"
        with StepProgress(f"{title}: actions", contender.config.sim.max_steps) as driven:

            def on_moment(moment: Moment, moments: list[Moment] = moments, driven: StepProgress = driven) -> None:
                moments.append(moment)
                driven.step()

            record = runner.drive(scene, random_streams.evaluated_episode(seed, index), on_moment)
        file = folder / f"{index:02d}-{scene.name}-{record.outcome}.mp4"
        actions = len(moments) - 1
        with StepProgress(f"{title}: frames", actions * FRAMES_PER_ACTION + LAST_FRAMES) as drawn:
            pictures = _counted(frames(moments, contender.config, visual_act), drawn)
            film_file.write(pictures, file, actions // 2 * FRAMES_PER_ACTION)
        files.append(file)
        on_film(file)
    return files


def frames(moments: Sequence[Moment], config: Config, visual_act: Any) -> Iterator[np.ndarray]:
    """Yield the frames `(height, width, 3)` uint8 of an episode.

    Args:
        moments: moments of a whole episode that was driven with pictures.
        config: configuration of the driver.
        visual_act: vision model, whose `observe` gives the attention; None: no attention is shown.
    """
    scene, camera, find_attention = moments[0].scene, make_camera(config.camera), _attention_of(visual_act)
    chase = ChaseCamera(scene, PANEL_PX)
    belief = BeliefView(scene, Grid.from_config(config.grid), PANEL_PX)
    path: list[tuple[float, float]] = []

    def picture(
        moment: Moment, pose: Pose, people: np.ndarray | None, seen: np.ndarray, words: np.ndarray
    ) -> np.ndarray:
        return _frame((chase.render(pose, people), seen, belief.draw(moment.thought, pose, path, people)), words)

    for step, (moment, after) in enumerate(pairwise(moments), start=1):
        path.append(moment.observed.pose[:2])
        attention = find_attention(_image_of(moment), _action_of(moment))
        words = _words(caption(moment, step, config.sim.max_steps))
        for share in np.arange(FRAMES_PER_ACTION) / FRAMES_PER_ACTION:
            pose = between(moment.observed.pose, after.observed.pose, _action_of(moment), share)
            people = _people_between(moment.people, after.people, share)
            image = _image_of(moment) if share == 0 else camera.render(scene, pose, people=people)
            yield picture(moment, pose, people, _glowing(_panel(image), attention, (1 - share) ** 2), words)
    last = moments[-1]
    words = _words(caption(last, len(moments) - 1, config.sim.max_steps))
    end = picture(last, last.observed.pose, last.people, _panel(_image_of(last)), words)
    for _ in range(LAST_FRAMES):
        yield end
    camera.close()


def _counted(pictures: Iterator[np.ndarray], drawn: StepProgress) -> Iterator[np.ndarray]:
    for picture in pictures:
        drawn.step()
        yield picture


def between(before: Pose, after: Pose, action: Action, share: float) -> Pose:
    """Return the pose at a share of an action, which first turns and then moves."""
    turn = math.remainder(after.heading_rad - before.heading_rad, math.tau)
    turning = TURN_SHARE if ADVANCES[action] and abs(turn) > 0.2 else 0.0
    turned = 1.0 if not turn else min(share / turning, 1.0) if turning else share
    moved = max(share - turning, 0.0) / (1 - turning)
    return Pose(
        before.x_m + moved * (after.x_m - before.x_m),
        before.y_m + moved * (after.y_m - before.y_m),
        math.remainder(before.heading_rad + turned * turn, math.tau),
    )


def caption(moment: Moment, step: int, max_steps: int) -> tuple[str, str]:
    """Return the two lines under a frame: the action, and the observation and decision behind it.

    Args:
        moment: moment that is shown.
        step: number of the action, from 1.
        max_steps: limit of actions per episode.
    """
    about = f"{moment.scene.name}     action {step} of at most {max_steps}"
    if moment.outcome is not None:
        return about, f"ended: {moment.outcome}"
    first = f"{about}     {_action_of(moment).name.lower().replace('_', ' ')}"
    if moment.thought is None:
        return first, "this driver has no map"
    situation, decision = moment.thought.situation, moment.thought.decision
    advice = "   ".join(f"{name} {value:+.2f}" for name, value in zip(DIRECTIONS, situation.advice, strict=True))
    east, north = situation.grid.block_of(*situation.grid.cell_at(*decision.subgoal))
    option = "the goal" if decision.subgoal == situation.goal else f"block {east + 1} east, {north + 1} north"
    shield = "the shield changed the action" if decision.shield_changed else "the shield kept the action"
    return first, f"R_p:  {advice}     option: {option}     {shield}"


def _frame(panels: Sequence[np.ndarray], words: np.ndarray) -> np.ndarray:
    """Return panels side by side with their titles, above the picture of the caption."""
    picture = np.full((PANEL_PX + CAPTION_PX, _WIDTH_PX, 3), 255, np.uint8)
    for index, panel in enumerate(panels):
        offset = index * (PANEL_PX + GAP_PX)
        picture[:PANEL_PX, offset : offset + PANEL_PX] = panel
    for (left, top), title in _titles():
        picture[top : top + len(title), left : left + title.shape[1]] = title
    picture[PANEL_PX:] = words
    return picture


def _words(lines: Sequence[str]) -> np.ndarray:
    """Return the picture of a caption, `(CAPTION_PX, width, 3)` uint8."""
    image = Image.new("RGB", (_WIDTH_PX, CAPTION_PX), "white")
    pen = ImageDraw.Draw(image)
    for index, line in enumerate(lines):
        pen.text((10, 10 + 32 * index), line, font=_font(18), fill=style.BLACK)
    return np.asarray(image)


@cache
def _titles() -> list[tuple[tuple[int, int], np.ndarray]]:
    """Return the corners (left, top) and pictures of the titles."""
    titles = []
    for index, title in enumerate(_TITLES):
        left, top, right, bottom = (round(side) for side in _font(15).getbbox(title))
        image = Image.new("RGB", (right - left + 11, bottom - top + 9), "white")
        ImageDraw.Draw(image).text((5 - left, 4 - top), title, font=_font(15), fill=style.BLACK)
        titles.append(((index * (PANEL_PX + GAP_PX) + 3 + left, 3 + top), np.asarray(image)))
    return titles


@cache
def _font(size_px: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(font_manager.findfont(style.FONT), size_px)


def _action_of(moment: Moment) -> Action:
    assert moment.action is not None, "only the last moment of an episode has no action"
    return Action(moment.action)


def _image_of(moment: Moment) -> np.ndarray:
    assert moment.observed.image is not None, "filmed episodes are driven with pictures"
    return moment.observed.image


def _panel(image: np.ndarray) -> np.ndarray:
    return cv2.resize(image, (PANEL_PX, PANEL_PX), interpolation=cv2.INTER_LINEAR)


def _attention_of(visual_act: Any) -> Callable[[np.ndarray, Action], np.ndarray | None]:
    """Return the function from an image and the action taken to a heat map of a panel; None: there is no attention."""

    def missing(image: np.ndarray, action: Action) -> None:
        return None

    def find(image: np.ndarray, action: Action) -> np.ndarray:
        direction = _DIRECTION_OF[action]
        weights = visual_act.observe(image[None]).attention[0, direction]
        side, seen = round(len(weights) ** 0.5), seen_share(visual_act.read(image[None]).clearance)[0, direction]
        return overlay(weights.reshape(side, side), PANEL_PX, float(seen)).astype(np.float32)

    if not hasattr(visual_act, "observe"):
        return missing
    try:
        visual_act.observe(np.zeros((1, 64, 64, 3), np.uint8))
    except WeightsError:
        return missing
    return find


def _glowing(panel: np.ndarray, attention: np.ndarray | None, strength: float) -> np.ndarray:
    """Return a panel with a heat map over it, whose strength is 0 to 1."""
    if attention is None:
        return panel
    alpha = _GLOW * np.float32(strength) * attention[..., 3:]
    return np.round((1 - alpha) * panel + 255 * alpha * attention[..., :3]).astype(np.uint8)


def _people_between(before: np.ndarray | None, after: np.ndarray | None, share: float) -> np.ndarray | None:
    return None if before is None or after is None else before + share * (after - before)
