"""Reassembly of a ring buffer's state from its layout and the pieces of rows in a journal."""

from collections.abc import Iterable, Mapping

import numpy as np

from zsdist.errors import RunError

Columns = Mapping[str, np.ndarray]


def join(layout: Columns, size: int, pieces: Iterable[tuple[int, Columns]]) -> dict[str, np.ndarray]:
    """Return the `RingBuffer.state` that belongs to a `RingBuffer.layout`.

    Args:
        layout: capacity, head, number of rows written, and everything else except the rows.
        size: number of stored rows.
        pieces: serial of the first row of each piece, and its rows; rows older than the stored ones are skipped.

    Raises:
        RunError: rows are missing.
    """
    capacity, head, written = (int(layout[name]) for name in ("capacity", "head", "written"))
    state: dict[str, np.ndarray] = {}
    found = 0
    for first, rows in pieces:
        serials = np.arange(first, first + len(next(iter(rows.values()))))
        kept = serials[(serials >= written - size) & (serials < written)]
        positions = (head - written + kept) % capacity
        for name, column in rows.items():
            whole = state.setdefault(name, np.empty((size, *column.shape[1:]), column.dtype))
            whole[positions] = column[kept - first]
        found += len(kept)
    if found != size:
        raise RunError(f"replay journal has {found} of the {size} rows of its ring; the others are missing")
    return {**state, **layout}
