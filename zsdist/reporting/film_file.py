"""Film files: H.264 in MP4, which browsers play from their first bytes on. A film is whole or not there."""

import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import av
import numpy as np
from PIL import Image

from zsdist.common import atomic_files
from zsdist.errors import RunError

FRAMES_PER_SECOND = 10
CODEC: Final = "libx264"
PIXELS = "yuv420p"  # the only ones of H.264 that every browser shows
STILL_QUALITY = 88
_KEY_FRAMES_S = 5  # distance of the frames to which a player can jump
_BT709 = 1  # number of the colour space, its primaries and its transfer in H.264
_LIMITED_RANGE = 1


def write(pictures: Iterable[np.ndarray], file: Path, still: int) -> None:
    """Write frames of one size as an MP4, and one of them as a JPEG of the same name.

    Both appear under their names once they are complete. Whatever ends the writing before leaves neither.

    Args:
        pictures: frames `(height, width, 3)` uint8, with even width and height, one or more.
        file: MP4 to write.
        still: number of the frame to write as a JPEG, from 0.

    Raises:
        RunError: it cannot be written.
    """
    partial, shown = file.with_name(f".{file.name}.partial"), b""
    try:
        with (
            _errors_of(file),
            av.open(str(partial), mode="w", format="mp4", container_options={"movflags": "+faststart"}) as container,
        ):
            stream = None
            for number, picture in enumerate(pictures):
                if stream is None:
                    stream = _add_stream(container, picture)
                frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
                container.mux(stream.encode(frame.reformat(format=PIXELS, dst_colorspace="ITU709")))
                if number == still:
                    shown = _jpeg(picture)
            if stream is not None:
                container.mux(stream.encode())
        atomic_files.replace(file.with_suffix(".jpg"), shown, sync=False)
        partial.replace(file)
    finally:
        partial.unlink(missing_ok=True)


def _add_stream(container: av.container.OutputContainer, picture: np.ndarray) -> av.VideoStream:
    stream = container.add_stream(CODEC, rate=FRAMES_PER_SECOND, options={"preset": "veryfast"})
    stream.height, stream.width = picture.shape[:2]
    stream.pix_fmt = PIXELS
    context = stream.codec_context
    context.gop_size = _KEY_FRAMES_S * FRAMES_PER_SECOND
    context.colorspace = context.color_primaries = context.color_trc = _BT709
    context.color_range = _LIMITED_RANGE
    return stream


@contextmanager
def _errors_of(file: Path) -> Iterator[None]:
    """Turn errors of PyAV into a `RunError` in one line."""
    try:
        yield
    except av.codec.codec.UnknownCodecError as error:
        raise RunError(f"film {file} cannot be written: PyAV has no {CODEC} here; allowed is its own wheel") from error
    except av.FFmpegError as error:
        raise RunError(f"film {file} cannot be written: {error.strerror}") from error


def _jpeg(picture: np.ndarray) -> bytes:
    content = io.BytesIO()
    Image.fromarray(picture).save(content, "JPEG", quality=STILL_QUALITY)
    return content.getvalue()
