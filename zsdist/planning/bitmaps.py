"""Bitmaps of the fine grid: 64 fine cells of a row to a word, so that one operation acts on 64 cells at once.

A bitmap is `(size, words)` uint64; bit j of a row's word w is its fine cell `FINE_CELLS_PER_WORD * w + j`.
"""

import numpy as np

from zsdist.common.compiled import compiled

FINE_CELLS_PER_WORD = 64


@compiled()
def pack_rows(mask: np.ndarray) -> np.ndarray:
    """Return the bitmap of a mask `[iy, ix]` `(size, size)` bool; bits beyond the last fine cell are 0."""
    size = mask.shape[1]
    full_words = size // FINE_CELLS_PER_WORD
    out = np.zeros((mask.shape[0], (size - 1) // FINE_CELLS_PER_WORD + 1), np.uint64)
    for iy in range(mask.shape[0]):
        for word in range(full_words):
            bits = np.uint64(0)
            for bit in range(FINE_CELLS_PER_WORD):
                bits |= np.uint64(mask[iy, FINE_CELLS_PER_WORD * word + bit]) << np.uint64(bit)
            out[iy, word] = bits
        for bit in range(size - FINE_CELLS_PER_WORD * full_words):
            out[iy, full_words] |= np.uint64(mask[iy, FINE_CELLS_PER_WORD * full_words + bit]) << np.uint64(bit)
    return out


@compiled()
def erosion(bitmap: np.ndarray, radius: int) -> np.ndarray:
    """Return the morphological erosion of a bitmap by a diamond: the cells whose whole neighbourhood is set.

    Args:
        bitmap: `(size, words)`; outside the grid all cells count as set.
        radius: radius of the diamond, in steps between cells that share a side.

    Returns:
        `(size, words)`; bits beyond the last fine cell are undefined.
    """
    size, words = bitmap.shape
    one, rest = np.uint64(1), np.uint64(FINE_CELLS_PER_WORD - 1)
    used = np.uint64(size - FINE_CELLS_PER_WORD * (words - 1))  # bits of a row's last word
    beyond = ~np.uint64(0) << used if used < FINE_CELLS_PER_WORD else np.uint64(0)
    now, then = np.empty((size + 2, words), np.uint64), np.full((size + 2, words), ~np.uint64(0))
    now[0] = now[-1] = ~np.uint64(0)
    now[1:-1] = bitmap
    for _ in range(radius):
        now[:, -1] |= beyond
        for iy in range(1, size + 1):
            for word in range(words):
                here = now[iy, word]
                west = here << one | (now[iy, word - 1] >> rest if word > 0 else one)
                east = here >> one | (now[iy, word + 1] if word < words - 1 else one) << rest
                then[iy, word] = here & west & east & now[iy - 1, word] & now[iy + 1, word]
        now, then = then, now
    return now[1:-1].copy()


@compiled()
def opening(bitmap: np.ndarray, radius: int) -> np.ndarray:
    """Return the morphological opening by a diamond: an erosion, then a dilation. It removes thin parts only."""
    return ~erosion(~erosion(bitmap, radius), radius)


@compiled()
def window(bitmap: np.ndarray, first: int, rows: int, words: int) -> np.ndarray:
    """Return the part `(rows, words)` that begins at row and column `first`; outside the grid all cells are set."""
    size, stored_words = bitmap.shape
    beyond = np.uint64(0)
    if size % FINE_CELLS_PER_WORD:
        beyond = ~np.uint64(0) << np.uint64(size - FINE_CELLS_PER_WORD * (stored_words - 1))
    out = np.full((rows, words), ~np.uint64(0))
    shift, skipped = np.uint64(first % FINE_CELLS_PER_WORD), first // FINE_CELLS_PER_WORD
    for row in range(max(0, -first), min(rows, size - first)):
        for word in range(words):
            bits = ~np.uint64(0)
            for part in range(2):
                source = word + skipped + part
                source_bits = ~np.uint64(0)
                if 0 <= source < stored_words:
                    source_bits = bitmap[row + first, source] | (beyond if source == stored_words - 1 else np.uint64(0))
                if part == 0:
                    bits = source_bits >> shift
                elif shift:
                    bits |= source_bits << (np.uint64(FINE_CELLS_PER_WORD) - shift)
            out[row, word] = bits
    return out
