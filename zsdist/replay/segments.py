"""Reassembly of a ring buffer's state from its layout and the pieces of rows in a journal."""

from collections.abc import Iterable, Mapping

import numpy as np

Columns = Mapping[str, np.ndarray]

RENUMBERED = 2**32  # more rows than are ever sampled before their priorities come back


def join(layout: Columns, size: int, pieces: Iterable[tuple[int, Columns]]) -> tuple[dict[str, np.ndarray], int]:
    """Return the `RingBuffer.state` that belongs to a `RingBuffer.layout`, and the number of rows that it lacks.

    Where rows are missing, the others are there in their order, with new serials: a priority that was computed under an
    old serial belongs to none of them.

    Args:
        layout: capacity, head, number of rows written, and everything else except the rows.
        size: number of rows that were stored.
        pieces: serial of the first row of each piece, and its rows; rows older than the stored ones are skipped.
    """
    capacity, head, written = (int(layout[name]) for name in ("capacity", "head", "written"))
    rows: dict[str, np.ndarray] = {}
    is_there = np.zeros(size, bool)  # in ring order
    for first, columns in pieces:
        serials = np.arange(first, first + len(next(iter(columns.values()))))
        kept = serials[(serials >= written - size) & (serials < written)]
        positions = (head - written + kept) % capacity
        for name, column in columns.items():
            whole = rows.setdefault(name, np.empty((size, *column.shape[1:]), column.dtype))
            whole[positions] = column[kept - first]
        is_there[positions] = True
    if is_there.all():
        return {**rows, **layout}, 0
    by_age = (head - size + np.arange(size)) % capacity
    found = by_age[is_there[by_age]]
    moved = {name: column[found] for name, column in rows.items()}
    if "priorities" in layout:
        moved["priorities"] = layout["priorities"][found]
    place = {"head": np.array(len(found) % capacity), "written": np.array(written + RENUMBERED + len(found))}
    return {**layout, **moved, **place}, size - len(found)
