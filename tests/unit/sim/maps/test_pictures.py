"""Pictures of maps: PGM plain and binary, of 8 and 16 bits, PNG of every kind."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image

from zsdist.errors import SceneError
from zsdist.sim.maps import pictures


def pgm(values: np.ndarray, most: int, kind: str) -> bytes:
    head = f"{kind}\n# made by a test\n{values.shape[1]} {values.shape[0]}\n{most}\n".encode()
    if kind == "P2":
        return head + "\n".join(" ".join(map(str, row)) for row in values.tolist()).encode()
    return head + values.astype(">u2" if most > 255 else np.uint8).tobytes()


@settings(max_examples=40, deadline=None)
@given(
    values=arrays(np.uint8, array_shapes(min_dims=2, max_dims=2, max_side=6)),
    kind=st.sampled_from(["P2", "P5"]),
    wide=st.booleans(),
)
def test_a_pgm_reads_back_whatever_its_form(values, kind, wide):
    written = pgm(values.astype(int) * 257, 65535, kind) if wide else pgm(values, 255, kind)
    assert (pictures.parse_pgm(written) == values).all()


def test_other_greatest_values_are_scaled_to_8_bits_and_rounded():
    assert pictures.parse_pgm(b"P2 3 1 100 0 50 100").tolist() == [[0, 128, 255]]
    assert pictures.parse_pgm(b"P2 3 1 65535 127 129 65535").tolist() == [[0, 1, 255]]


def test_comments_may_stand_anywhere_in_the_head():
    assert pictures.parse_pgm(b"P5#a\n# CREATOR: x 0.050 m/pix\n2 #b\n1\n255\n\x23\x0a").tolist() == [[35, 10]]


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "P2 and P5"),
        (b"P6 1 1 255 abc", "P2 and P5"),
        (b"P5 2 2 255\n\x00", "cut off"),
        (b"P2 2 2 255 1 2 3", "cut off"),
        (b"P2 2 1 255 1 x", "no whole number"),
        (b"P2 2 1 9 1 10", "above its greatest value"),
        (b"P5 0 1 255\n", "above 0"),
        (b"P5 1 1 70000\n\x00\x00", "1 to 65535"),
        (b"P5 x 1 255\n", "no width"),
        (b"P5 99999 99999 255\n", "cells"),
    ],
)
def test_a_wrong_pgm_is_refused_with_the_reason(content, why):
    with pytest.raises(SceneError, match=why):
        pictures.parse_pgm(content)


@pytest.mark.parametrize("mode", ["1", "L", "P", "RGB", "I;16"])
def test_an_opaque_png_gives_its_grey_values(tmp_path, mode):
    values = np.array([[0, 255], [255, 0]], np.uint8)
    picture = Image.fromarray(values)
    picture = Image.fromarray(values.astype(np.uint16) * 257) if mode == "I;16" else picture.convert(mode)
    picture.save(tmp_path / "a.png")
    grey, transparent = pictures.read(tmp_path / "a.png")
    assert (grey == values).all() and transparent is None and grey.dtype == np.uint8


@pytest.mark.parametrize("mode", ["LA", "RGBA"])
def test_a_png_says_where_it_is_transparent(tmp_path, mode):
    picture = Image.new(mode, (2, 1), (7, 255) if mode == "LA" else (7, 7, 7, 255))
    picture.putpixel((1, 0), (9, 254) if mode == "LA" else (9, 9, 9, 254))
    picture.save(tmp_path / "a.png")
    grey, transparent = pictures.read(tmp_path / "a.png")
    assert grey.tolist() == [[7, 9]] and transparent.tolist() == [[False, True]]


@pytest.mark.parametrize(("name", "content"), [("a.png", b"no"), ("a.tif", b"II"), ("none.pgm", None)])
def test_a_picture_that_cannot_be_read_is_refused_by_its_name(tmp_path, name, content):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(SceneError, match=name):
        pictures.read(tmp_path / name)
