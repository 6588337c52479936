import cv2
import numpy as np
import pytest

from zsdist.planning import bitmaps

SIZES = (5, 63, 64, 65, 160)


def patches(size, seed=0):
    """Squares that are set in patches of several sizes, some of them at the edge."""
    noise = np.random.default_rng([seed, size]).random((size, size)).astype(np.float32)
    return cv2.blur(noise, (5, 5)) > 0.5


def flags(rows, size):
    """The squares `[iy, ix]` of rows of words."""
    return np.unpackbits(rows.view(np.uint8), axis=1, bitorder="little")[:, :size].astype(bool)


@pytest.mark.parametrize("size", SIZES)
def test_rows_hold_each_square_at_its_bit_and_nothing_beyond(size):
    rows = bitmaps.packed_rows(patches(size))
    assert np.array_equal(flags(rows, size), patches(size))
    assert np.unpackbits(rows.view(np.uint8)).sum() == patches(size).sum() > 0


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("steps", [1, 3])
def test_shrinking_and_opening_are_those_of_image_processing(size, steps):
    away = np.abs(np.arange(-steps, steps + 1))
    diamond = (away[:, None] + away <= steps).astype(np.uint8)
    image, rows = patches(size, steps), bitmaps.packed_rows(patches(size, steps))
    for made, operation in ((bitmaps.eroded, cv2.MORPH_ERODE), (bitmaps.opening, cv2.MORPH_OPEN)):
        expected = cv2.morphologyEx(image.astype(np.uint8), operation, diamond).astype(bool)
        assert np.array_equal(flags(made(rows, steps), size), expected)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("first", [-70, -3, 0, 4, 66])
def test_a_window_shows_the_squares_from_its_corner_and_outside_the_frame_all_are_set(size, first):
    shown = flags(bitmaps.window(bitmaps.packed_rows(patches(size)), first, 90, 3), 192)
    wide = np.ones((400, 400), bool)
    wide[100 : 100 + size, 100 : 100 + size] = patches(size)
    assert np.array_equal(shown, wide[100 + first : 190 + first, 100 + first : 292 + first])
