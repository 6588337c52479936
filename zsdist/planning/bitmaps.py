"""Squares of the fine frame as bits, 64 of a row a word: what is done to one of them is done to 64 at once.

Rows are `(size, words)` uint64; bit j of a row's word w is its square `SQUARES_A_WORD * w + j`.
"""

import numpy as np

from zsdist.common.compiled import compiled

SQUARES_A_WORD = 64


@compiled()
def packed_rows(squares: np.ndarray) -> np.ndarray:
    """Rows of `[iy, ix]` `(size, size)` bool; 0 beyond the last square."""
    size = squares.shape[1]
    whole = size // SQUARES_A_WORD
    out = np.zeros((squares.shape[0], (size - 1) // SQUARES_A_WORD + 1), np.uint64)
    for iy in range(squares.shape[0]):
        for word in range(whole):
            bits = np.uint64(0)
            for bit in range(SQUARES_A_WORD):
                bits |= np.uint64(squares[iy, SQUARES_A_WORD * word + bit]) << np.uint64(bit)
            out[iy, word] = bits
        for bit in range(size - SQUARES_A_WORD * whole):
            out[iy, whole] |= np.uint64(squares[iy, SQUARES_A_WORD * whole + bit]) << np.uint64(bit)
    return out


@compiled()
def eroded(squares: np.ndarray, steps: int) -> np.ndarray:
    """Squares from which no way of so many steps along rows and columns leads to one that is not among them.

    Args:
        squares: `(size, words)`; outside the frame all are among them.
        steps: from a square to one that shares a side with it.

    Returns:
        `(size, words)`; bits beyond the last square mean nothing.
    """
    size, words = squares.shape
    one, rest = np.uint64(1), np.uint64(SQUARES_A_WORD - 1)
    used = np.uint64(size - SQUARES_A_WORD * (words - 1))  # bits of a row's last word
    beyond = ~np.uint64(0) << used if used < SQUARES_A_WORD else np.uint64(0)
    now, then = np.empty((size + 2, words), np.uint64), np.full((size + 2, words), ~np.uint64(0))
    now[0] = now[-1] = ~np.uint64(0)
    now[1:-1] = squares
    for _ in range(steps):
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
def opening(squares: np.ndarray, steps: int) -> np.ndarray:
    """Squares within so many steps of one that `shrunk` leaves: slivers among them are gone, the rest is whole."""
    return ~eroded(~eroded(squares, steps), steps)


@compiled()
def window(squares: np.ndarray, first: int, tall: int, words: int) -> np.ndarray:
    """`(tall, words)` words of squares from the row and column `first` on; outside the frame all are set."""
    size, held = squares.shape
    beyond = ~np.uint64(0) << np.uint64(size - SQUARES_A_WORD * (held - 1)) if size % SQUARES_A_WORD else np.uint64(0)
    out = np.full((tall, words), ~np.uint64(0))
    shift, skipped = np.uint64(first % SQUARES_A_WORD), first // SQUARES_A_WORD
    for row in range(max(0, -first), min(tall, size - first)):
        for word in range(words):
            bits = ~np.uint64(0)
            for part in range(2):
                at = word + skipped + part
                of_these = ~np.uint64(0)
                if 0 <= at < held:
                    of_these = squares[row + first, at] | (beyond if at == held - 1 else np.uint64(0))
                if part == 0:
                    bits = of_these >> shift
                elif shift:
                    bits |= of_these << (np.uint64(SQUARES_A_WORD) - shift)
            out[row, word] = bits
    return out
