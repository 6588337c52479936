"""Networks of a bundle, run by onnxruntime: vision from pictures to views, and the Q-functions of both levels."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime

from zsdist.agent.epsilon_greedy import QFunction
from zsdist.errors import BundleError
from zsdist.runtime.bundle import NETWORK_FILES, VISION_FILE, Bundle
from zsdist.types import Level, View
from zsdist.vision.encoders.base import resample
from zsdist.vision.exported import session_options
from zsdist.vision.ray_ablation import ablate_rays
from zsdist.vision.reading import READING_OUTPUTS, Reading, Views

Run = Callable[[np.ndarray], list[np.ndarray]]

PICTURE, STATE, VALUES = "image", "state", "values"
"""Names of the inputs and outputs in the files."""


class BundleVision:
    """Vision of a bundle: from a picture to what the agent gets.

    Args:
        bundle: bundle of the policy.
        threads: number of threads.

    Raises:
        BundleError: onnxruntime cannot open the network, or it is another one than the manifest says.
    """

    def __init__(self, bundle: Bundle, threads: int) -> None:
        session = _open(bundle, VISION_FILE, threads, PICTURE, READING_OUTPUTS)
        self._run, self._px = session.run, int(session.get_inputs()[0].shape[1])
        settings = bundle.config.vision
        self._rays = settings.rays
        self._views = Views(settings.ray_quantile, float(np.radians(bundle.camera.field_of_view_deg)))

    def view(self, picture: np.ndarray, goal_bearing_rad: float, goal_distance_m: float) -> View:
        """Return the view of one picture.

        Args:
            picture: `(px, px, 3)` uint8, square.
            goal_bearing_rad: direction of the goal from the robot's heading, left positive.
            goal_distance_m: distance of the goal.
        """
        images = resample(picture[None], self._px)
        reading = Reading(*self._run(READING_OUTPUTS, {PICTURE: images}))
        (view,) = self._views.of(reading, np.array([goal_bearing_rad]), np.array([goal_distance_m]))
        return ablate_rays(view, self._rays)


def q_networks(bundle: Bundle, threads: int) -> dict[Level, QFunction]:
    """Return the Q-functions of a bundle, for `HierarchicalAgent.act`.

    Raises:
        BundleError: onnxruntime cannot open a network, or it is another one than the manifest says.
    """
    return {level: _q_function(bundle, file, threads) for level, file in NETWORK_FILES.items()}


def _q_function(bundle: Bundle, file: str, threads: int) -> QFunction:
    session = _open(bundle, file, threads, STATE, [VALUES])

    def values(states: np.ndarray) -> np.ndarray:
        found: np.ndarray = session.run([VALUES], {STATE: states})[0]
        return found

    return values


def _open(bundle: Bundle, file: str, threads: int, given: str, wanted: list[str]) -> onnxruntime.InferenceSession:
    path: Path = bundle.folder / file
    try:
        session = onnxruntime.InferenceSession(str(path), session_options(threads), providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's errors share no narrower base class
        reason = " ".join(str(error).split())[:200]
        raise BundleError(
            f"bundle {bundle.folder}: onnxruntime {onnxruntime.__version__} cannot open {file} ({reason}); allowed is "
            "onnxruntime 1.20 or later"
        ) from error
    inputs = [port.name for port in session.get_inputs()]
    outputs = [port.name for port in session.get_outputs()]
    if inputs != [given] or outputs != wanted:
        raise BundleError(
            f"bundle {bundle.folder}: {file} leads from {', '.join(inputs)} to {', '.join(outputs)}; allowed is from "
            f"{given} to {', '.join(wanted)}: export the policy again"
        )
    return session
