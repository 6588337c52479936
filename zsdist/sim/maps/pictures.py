"""Pictures of maps: grey values and transparency of PGM, PNG and BMP files, as map_server sees them."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from zsdist.errors import SceneError

MAX_CELLS = 64_000_000  # 8000 x 8000: 400 m at 5 cm
FORMATS = (".pgm", ".png", ".bmp")
_WHITE = b" \t\r\n\v\f"


def read(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the grey values of a picture, and where it is transparent.

    Values of other depths are scaled to 8 bits and rounded. Colours become grey by ITU-R 601 luma.

    Returns:
        `(rows, columns)` uint8, the first row the upper one; and the same shape bool, true where it is not opaque, or
        None for a picture without transparency.

    Raises:
        SceneError: the file is missing, damaged, too large or of another kind.
    """
    if path.suffix.lower() not in FORMATS:
        raise SceneError(f"picture {path} has the ending {path.suffix!r}; allowed are {', '.join(FORMATS)}")
    try:
        if path.suffix.lower() == ".pgm":
            return parse_pgm(path.read_bytes()), None
        with Image.open(path, formats=("PNG", "BMP")) as picture:
            _check_size(*picture.size)
            return _grey(picture)
    except UnidentifiedImageError as error:
        raise SceneError(f"picture {path} is damaged or no {path.suffix[1:].upper()}") from error
    except OSError as error:
        raise SceneError(f"picture {path} cannot be read: {error.strerror or error}") from error
    except (SceneError, ValueError, SyntaxError) as error:  # Pillow reports damaged PNG as SyntaxError
        raise SceneError(f"picture {path}: {error}") from error


def parse_pgm(content: bytes) -> np.ndarray:
    """Return the grey values of a PGM, `(rows, columns)` uint8: plain (P2) or binary (P5), of 8 or 16 bits.

    Raises:
        SceneError: it is no PGM, or is cut off.
    """
    words = _words(content)
    (kind, _), *sizes = [next(words, (b"", 0)) for _ in range(4)]
    if kind not in (b"P2", b"P5"):
        raise SceneError(f"it begins with {kind[:8].decode('latin-1')!r}; allowed are the PGM marks P2 and P5")
    if not all(word.isdigit() and len(word) < 9 for word, _ in sizes):
        raise SceneError("its head has no width, height and greatest value")
    columns, rows, most = (int(word) for word, _ in sizes)
    if not (columns and rows and 1 <= most <= 65535):
        raise SceneError(
            f"its size is {columns} x {rows}, its greatest value {most}; allowed is a size above 0 and 1 to 65535"
        )
    _check_size(columns, rows)
    values = _plain(words, rows * columns) if kind == b"P2" else _binary(content[sizes[-1][1] + 1 :], most)
    if len(values) < rows * columns:
        raise SceneError(f"it has {len(values)} of {rows * columns} values; it is cut off")
    values = values[: rows * columns].reshape(rows, columns)
    if values.max() > most:
        raise SceneError(f"it has the value {values.max()}, above its greatest value {most}")
    return _to_bytes(values, most)


def _plain(words: Iterator[tuple[bytes, int]], count: int) -> np.ndarray:
    texts = [word for word, _ in words][:count]
    if not all(text.isdigit() and len(text) < 9 for text in texts):
        raise SceneError("it has a value that is no whole number")
    return np.array([int(text) for text in texts], np.int64)


def _binary(content: bytes, most: int) -> np.ndarray:
    kind = np.dtype(">u2") if most > 255 else np.dtype(np.uint8)
    return np.frombuffer(content[: len(content) // kind.itemsize * kind.itemsize], kind)


def _words(content: bytes) -> Iterator[tuple[bytes, int]]:
    """Yield the words of a PGM's head with the place behind each; comments run from `#` to the end of the line."""
    at = 0
    while at < len(content):
        if content[at] in _WHITE:
            at += 1
        elif content[at : at + 1] == b"#":
            end = content.find(b"\n", at)
            at = len(content) if end < 0 else end
        else:
            begin = at
            while at < len(content) and content[at] not in _WHITE and content[at : at + 1] != b"#":
                at += 1
            yield content[begin:at], at


def _grey(picture: Image.Image) -> tuple[np.ndarray, np.ndarray | None]:
    if picture.mode.startswith("I"):  # 16 bits
        return _to_bytes(np.asarray(picture).astype(np.int64).clip(0, 65535), 65535), None
    see_through = "A" in picture.mode or "transparency" in picture.info
    if not see_through:
        return np.asarray(picture.convert("RGB" if picture.mode == "P" else picture.mode).convert("L")), None
    whole = picture.convert("RGBA")
    return np.asarray(whole.convert("RGB").convert("L")), np.asarray(whole)[..., 3] < 255


def _to_bytes(values: np.ndarray, most: int) -> np.ndarray:
    return ((values.astype(np.int64) * 510 + most) // (2 * most)).astype(np.uint8)


def _check_size(columns: int, rows: int) -> None:
    if columns * rows > MAX_CELLS:
        raise SceneError(f"it has {columns} x {rows} cells; allowed are {MAX_CELLS} in all")
