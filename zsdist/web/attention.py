"""Attention on the picture of a car that is looked at closely, computed here, so that the run is not held up.

Only the weights of encoder and head are needed, which the package has. They are opened when a car is first looked at.
"""

import base64
import binascii
import io
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from zsdist.config import Config
from zsdist.errors import ZsdistError

Fields = dict[str, Any]
MOST_PX = 1024  # side of a picture


class Attention:
    """Attention of a run's vision model.

    Args:
        settings: returns the configuration of the run.
    """

    def __init__(self, settings: Callable[[], Config]) -> None:
        self._settings = settings
        self._loader: threading.Thread | None = None
        self._model: Any = None
        self._told = "the vision model is being opened"

    def __call__(self, view: Fields) -> Fields:
        """Return what is added to a view: `attention`, or in `attention_told` why there is none.

        `attention` has `side`, `weights` of forward, left and right, each `side * side` numbers from the upper left,
        and `seen`, the probability that something is within range in each direction.
        """
        if "picture" not in view:
            return {}
        if self._loader is None:
            self._loader = threading.Thread(target=self._load, name="attention", daemon=True)
            self._loader.start()
        if self._model is None:
            return {"attention_told": self._told}
        picture = _decode(view["picture"])
        if picture is None:
            return {"attention_told": "the picture cannot be read"}
        try:
            weights = self._model.observe(picture[None]).attention[0]
        except ZsdistError as error:
            return {"attention_told": str(error)}
        seen = 1.0 - self._model.read(picture[None]).clearance[0, :, -1]
        return {
            "attention": {
                "side": round(weights.shape[1] ** 0.5),
                "weights": np.round(weights, 4).tolist(),
                "seen": np.round(seen, 3).tolist(),
            }
        }

    def _load(self) -> None:
        from zsdist.vision.visual_act import VisualAct

        try:
            settings = self._settings()
            model = VisualAct.load(settings.vision, settings.camera)
            model.observe(np.zeros((1, 64, 64, 3), np.uint8))  # opens encoder and head
        except ZsdistError as error:
            self._told = str(error)
        else:
            self._model = model


def _decode(picture: object) -> np.ndarray | None:
    """Return a JPEG in base64 as `(px, px, 3)` uint8; None where it is none."""
    from PIL import Image, UnidentifiedImageError

    try:
        content = base64.b64decode(picture, validate=True) if isinstance(picture, str) else b""
        with Image.open(io.BytesIO(content), formats=["JPEG"]) as image:
            if image.width != image.height or image.width > MOST_PX:
                return None
            return np.asarray(image.convert("RGB"))
    except (binascii.Error, UnidentifiedImageError, OSError, ValueError):
        return None
