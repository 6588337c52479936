"""Copy of a ring as it was at one moment, made in slices while the ring goes on."""

from collections.abc import Mapping

import numpy as np


class RingCopy:
    """Copy of a ring's rows at the moment of its making; rows are copied oldest first, before they are overwritten.

    Args:
        columns: columns of the ring, `(capacity, ...)` each; whoever writes into them calls `keep_ahead` first.
        size: number of rows held, which are the first ones.
        oldest: index of the oldest row.
        others: arrays of the ring's state besides its rows, which belong to the copy.
    """

    def __init__(
        self, columns: Mapping[str, np.ndarray], size: int, oldest: int, others: Mapping[str, np.ndarray]
    ) -> None:
        self._columns, self._size, self._oldest, self._others = columns, size, oldest, others
        self._rows = {name: np.empty((size, *column.shape[1:]), column.dtype) for name, column in columns.items()}
        self._copied = 0

    @property
    def done(self) -> bool:
        """True once all rows are copied."""
        return self._copied == self._size

    def advance(self, most_bytes: int) -> int:
        """Copy further rows of at most so many bytes, but at least one; return the bytes that were copied."""
        row_bytes = sum(column[:1].nbytes for column in self._rows.values())
        before = self._copied
        self._copy_to(before + max(1, most_bytes // max(1, row_bytes)))
        return (self._copied - before) * row_bytes

    def keep_ahead(self, written: int) -> None:
        """Copy what is about to be overwritten.

        Args:
            written: number of rows written since the copy began, those about to be written included.
        """
        capacity = len(next(iter(self._columns.values())))
        self._copy_to(written - (capacity - self._size))

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what `RingBuffer.state` would have returned when the copy began; all rows must be copied."""
        assert self.done, f"{self._copied} of {self._size} rows are copied"
        return {**self._rows, **self._others}

    def _copy_to(self, count: int) -> None:
        """Copy rows until so many are copied, or all."""
        while self._copied < min(count, self._size):
            first = (self._oldest + self._copied) % self._size
            rows = slice(first, first + min(min(count, self._size) - self._copied, self._size - first))
            for name, column in self._columns.items():
                self._rows[name][rows] = column[rows]
            self._copied += rows.stop - rows.start
