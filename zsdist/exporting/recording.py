"""Steps of a policy in simulation, recorded with the code of evaluations, by which a bundle is checked."""

import contextlib
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy

from zsdist.common import random_streams
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.episodes import Moment
from zsdist.evaluation.selection import select
from zsdist.evaluation.workers import Simulation, make_runner
from zsdist.runtime.parity import choices

SCENES = "validation"  # split whose scenes are driven: of the training families, not seen in training
SEED = 0


def record_steps(
    contender: Contender,
    path: Path,
    steps: int,
    episodes: int = 0,
    simulation: Simulation | None = None,
    on_step: Callable[[int, int], None] = lambda done, least: None,
) -> None:
    """Drive validation scenes until there are enough steps and episodes, and write them as `runtime.parity` reads them.

    Args:
        contender: learned policy.
        path: file to write.
        steps: least number of steps.
        episodes: least number of episodes that are recorded whole; a further one is cut where there are enough steps.
        simulation: simulation to drive in; None: physics and the camera.
        on_step: called after each step with the number of steps done and the least number.
    """
    runner, rows = make_runner(contender, simulation), list[dict[str, Any]]()

    def watch(moment: Moment) -> None:
        if len(rows) >= steps and episode >= episodes:
            raise _Enough
        if moment.action is not None:
            rows.append(_row(episode, moment))
            on_step(len(rows), steps)

    with contextlib.suppress(_Enough):
        for episode in itertools.count():
            scene = select(SCENES, contender.config, episode + 1, SEED)[episode]
            runner.drive(scene, random_streams.evaluated_episode(SEED, episode), watch)
    columns = {name: np.ascontiguousarray(np.stack([row[name] for row in rows])) for name in rows[0]}
    safetensors.numpy.save_file(columns, path)


class _Enough(Exception):  # noqa: N818 (it is no error)
    """End of the recording in the middle of an episode."""


def _row(episode: int, moment: Moment) -> dict[str, Any]:
    observed, thought = moment.observed, moment.thought
    assert thought is not None and observed.image is not None, "a learned policy with a camera thinks and sees"
    return {
        "episode": np.array(episode, np.int32),
        "picture": observed.image.copy(),
        "pose": np.array(observed.pose, np.float64),
        "goal": np.array(observed.goal, np.float64),
        "action": np.array(moment.action, np.uint8),
        **choices(thought.decision.masks, thought.decision.values),
    }
