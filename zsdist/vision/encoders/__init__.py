"""Image encoders behind one protocol: pictures to tokens, texts to the space shared with pictures."""

from pathlib import Path

from zsdist.common import places
from zsdist.errors import WeightsError
from zsdist.vision.encoders.base import Encoder
from zsdist.vision.encoders.clip_folder import ClipFolder
from zsdist.vision.encoders.lite0 import EfficientNetLite0

DEFAULT = places.ENCODER


def open_encoder(spec: str) -> Encoder:
    """Return the encoder that `config.vision.encoder` names: the default one, or CLIP from a folder on this machine.

    Raises:
        WeightsError: the name is neither, or the weights are missing or damaged.
    """
    if spec == DEFAULT:
        return EfficientNetLite0()
    if Path(spec).is_dir():
        return ClipFolder(Path(spec))
    found = places.shown(spec)
    raise WeightsError(f"vision.encoder is {found!r}; allowed are {DEFAULT!r} and a folder with a CLIP model")
