"""Films of driven episodes: the car from behind, its camera picture with attention, and its belief map."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from zsdist.common import random_streams
from zsdist.config import Config
from zsdist.errors import RunError, WeightsError
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.drivers import Observability
from zsdist.evaluation.episodes import Moment
from zsdist.evaluation.workers import Simulation, make_runner
from zsdist.planning.footprint import ADVANCES
from zsdist.planning.grid import Grid
from zsdist.reporting import style
from zsdist.reporting.attention import attended, seen_share
from zsdist.reporting.belief_view import BeliefView
from zsdist.reporting.chase import ChaseCamera
from zsdist.sim.camera import make_camera
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Action, Pose
from zsdist.vision.labels import DIRECTIONS

PANEL_PX, GAP_PX, CAPTION_PX = 480, 6, 78
FRAMES_PER_ACTION = 5
FRAMES_PER_SECOND = 10  # an action takes 0.45 to 1 s in the simulation, half a second here
TURN_SHARE = 0.4  # share of frames for the turn, in an action that turns and then moves
LAST_FRAMES = 15
STILL_QUALITY = 88
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
    """Drive scenes again, as the evaluation with this seed does, and film each as an MP4.

    Between decisions the poses are interpolated: first the turn, then the movement. The camera's pictures between
    decisions are rendered for a level car. The attention shown belongs to the current action; it is missing for
    networks without attention and for drivers without a camera, and as faint as the network believes that nothing is
    within its range in this direction.

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
        record = runner.drive(scene, random_streams.evaluated_episode(seed, index), moments.append)
        file = folder / f"{index:02d}-{scene.name}-{record.outcome}.mp4"
        middle = (len(moments) - 1) // 2 * FRAMES_PER_ACTION
        write(frames(moments, contender.config, visual_act), file, middle)
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
    scene, camera, camera_panel = moments[0].scene, make_camera(config.camera), _camera_panel(visual_act)
    chase = ChaseCamera(scene, PANEL_PX)
    belief = BeliefView(scene, Grid.from_config(config.grid), PANEL_PX)
    path: list[tuple[float, float]] = []

    def picture(moment: Moment, pose: Pose, people: np.ndarray | None, image: np.ndarray, step: int) -> np.ndarray:
        panels = (
            chase.render(pose, people),
            camera_panel(image, moment.action),
            belief.draw(moment.thought, pose, path, people),
        )
        return _frame(panels, caption(moment, step, config.sim.max_steps))

    for step, (moment, after) in enumerate(pairwise(moments), start=1):
        path.append(moment.observed.pose[:2])
        for share in np.arange(FRAMES_PER_ACTION) / FRAMES_PER_ACTION:
            pose = between(moment.observed.pose, after.observed.pose, _action_of(moment), share)
            people = _people_between(moment.people, after.people, share)
            image = _image_of(moment) if share == 0 else camera.render(scene, pose, people=people)
            yield picture(moment, pose, people, image, step)
    last = moments[-1]
    end = picture(last, last.observed.pose, last.people, _image_of(last), len(moments) - 1)
    for _ in range(LAST_FRAMES):
        yield end
    camera.close()


def write(pictures: Iterable[np.ndarray], file: Path, still: int) -> None:
    """Write frames of one size as an MP4, and one of them as a JPEG of the same name.

    Args:
        pictures: frames `(height, width, 3)` uint8, with even width and height.
        file: MP4 to write.
        still: number of the frame to write as a JPEG, from 0.

    Raises:
        RunError: it cannot be written.
    """
    writer = None
    try:
        for number, picture in enumerate(pictures):
            if writer is None:
                size = (picture.shape[1], picture.shape[0])
                writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"mp4v"), FRAMES_PER_SECOND, size)
                if not writer.isOpened():
                    raise RunError(f"film {file} cannot be written: OpenCV cannot open it as mp4v")
            writer.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
            if number == still:
                Image.fromarray(picture).save(file.with_suffix(".jpg"), quality=STILL_QUALITY)
    finally:
        if writer is not None:
            writer.release()


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


def _frame(panels: Sequence[np.ndarray], lines: Sequence[str]) -> np.ndarray:
    width = len(panels) * (PANEL_PX + GAP_PX) - GAP_PX
    picture = np.full((PANEL_PX + CAPTION_PX, width, 3), 255, np.uint8)
    for index, panel in enumerate(panels):
        offset = index * (PANEL_PX + GAP_PX)
        picture[:PANEL_PX, offset : offset + PANEL_PX] = panel
    image = Image.fromarray(picture)
    pen = ImageDraw.Draw(image)
    for index, title in enumerate(_TITLES):
        corner = (index * (PANEL_PX + GAP_PX) + 8, 7)
        left, top, right, bottom = pen.textbbox(corner, title, font=_font(15))
        pen.rectangle((left - 5, top - 4, right + 5, bottom + 4), fill="white")
        pen.text(corner, title, font=_font(15), fill=style.BLACK)
    for index, line in enumerate(lines):
        pen.text((10, PANEL_PX + 10 + 32 * index), line, font=_font(18), fill=style.BLACK)
    return np.asarray(image)


@cache
def _font(size_px: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(font_manager.findfont(style.FONT), size_px)


def _action_of(moment: Moment) -> Action:
    assert moment.action is not None, "only the last moment of an episode has no action"
    return Action(moment.action)


def _image_of(moment: Moment) -> np.ndarray:
    assert moment.observed.image is not None, "filmed episodes are driven with pictures"
    return moment.observed.image


def _camera_panel(visual_act: Any) -> Callable[[np.ndarray, int | None], np.ndarray]:
    """Return the function that draws the camera panel from an image and the action taken."""

    def plain(image: np.ndarray, action: int | None) -> np.ndarray:
        return cv2.resize(image, (PANEL_PX, PANEL_PX), interpolation=cv2.INTER_LINEAR)

    def with_attention(image: np.ndarray, action: int | None) -> np.ndarray:
        panel = plain(image, action)
        if action is None:
            return panel
        direction = _DIRECTION_OF[Action(action)]
        weights = visual_act.observe(image[None]).attention[0, direction]
        side = round(len(weights) ** 0.5)
        return attended(
            panel, weights.reshape(side, side), seen_share(visual_act.read(image[None]).clearance)[0, direction]
        )

    if not hasattr(visual_act, "observe"):
        return plain
    try:
        visual_act.observe(np.zeros((1, 64, 64, 3), np.uint8))
    except WeightsError:
        return plain
    return with_attention


def _people_between(before: np.ndarray | None, after: np.ndarray | None, share: float) -> np.ndarray | None:
    return None if before is None or after is None else before + share * (after - before)
