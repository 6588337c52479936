import cv2
import numpy as np
import pytest

from zsdist.planning import bitmaps

SIZES = (5, 63, 64, 65, 160)


def patches(size, seed=0):
    """Return fine cells that are set in patches of several sizes, some of them at the edge."""
    noise = np.random.default_rng([seed, size]).random((size, size)).astype(np.float32)
    return cv2.blur(noise, (5, 5)) > 0.5


def flags(bitmap, size):
    """Return the fine cells `[iy, ix]` of a bitmap."""
    return np.unpackbits(bitmap.view(np.uint8), axis=1, bitorder="little")[:, :size].astype(bool)


@pytest.mark.parametrize("size", SIZES)
def test_a_bitmap_has_each_fine_cell_at_its_bit_and_nothing_beyond(size):
    bitmap = bitmaps.pack_rows(patches(size))
    assert np.array_equal(flags(bitmap, size), patches(size))
    assert np.unpackbits(bitmap.view(np.uint8)).sum() == patches(size).sum() > 0


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("radius", [1, 3])
def test_erosion_and_opening_are_those_of_image_processing(size, radius):
    away = np.abs(np.arange(-radius, radius + 1))
    diamond = (away[:, None] + away <= radius).astype(np.uint8)
    image, bitmap = patches(size, radius), bitmaps.pack_rows(patches(size, radius))
    for function, operation in ((bitmaps.erosion, cv2.MORPH_ERODE), (bitmaps.opening, cv2.MORPH_OPEN)):
        expected = cv2.morphologyEx(image.astype(np.uint8), operation, diamond).astype(bool)
        assert np.array_equal(flags(function(bitmap, radius), size), expected)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("first", [-70, -3, 0, 4, 66])
def test_a_window_has_the_fine_cells_from_its_corner_on_and_outside_the_grid_all_are_set(size, first):
    shown = flags(bitmaps.window(bitmaps.pack_rows(patches(size)), first, 90, 3), 192)
    wide = np.ones((400, 400), bool)
    wide[100 : 100 + size, 100 : 100 + size] = patches(size)
    assert np.array_equal(shown, wide[100 + first : 190 + first, 100 + first : 292 + first])
