"""A ring put together again from its layout and the pieces of rows that a journal holds."""

from collections.abc import Iterable, Mapping

import numpy as np

from zsdist.errors import RunError

Columns = Mapping[str, np.ndarray]


def joined(layout: Columns, size: int, pieces: Iterable[tuple[int, Columns]]) -> dict[str, np.ndarray]:
    """What `RingBuffer.state` gave when the ring had this `RingBuffer.layout`.

    Args:
        layout: capacity, head, rows written, and what else is no rows.
        size: rows that were stored.
        pieces: serial of its first row, and the rows, of each piece; rows older than the stored ones are passed over.

    Raises:
        RunError: rows are missing.
    """
    capacity, head, written = (int(layout[name]) for name in ("capacity", "head", "written"))
    columns: dict[str, np.ndarray] = {}
    found = 0
    for first, rows in pieces:
        serials = np.arange(first, first + len(next(iter(rows.values()))))
        kept = serials[(serials >= written - size) & (serials < written)]
        places = (head - written + kept) % capacity
        for name, column in rows.items():
            whole = columns.setdefault(name, np.empty((size, *column.shape[1:]), column.dtype))
            whole[places] = column[kept - first]
        found += len(kept)
    if found != size:
        raise RunError(f"replay journal has {found} of {size} rows of its ring")
    return {**columns, **layout}
