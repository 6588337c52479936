"""Array whose rows are in several files, which are read only where they are indexed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np


class Rows:
    """Concatenation of arrays along their first axis, indexed like one array without a copy of the whole.

    Args:
        parts: arrays `(n_i, ...)` of one dtype, usually memory-mapped files.
    """

    def __init__(self, parts: Sequence[np.ndarray]) -> None:
        self._parts = list(parts)
        self._ends = np.cumsum([len(part) for part in parts])
        self.dtype = parts[0].dtype
        self.shape = (int(self._ends[-1]), *parts[0].shape[1:])

    @classmethod
    def read(cls, paths: Sequence[Path]) -> Self:
        """Return the rows of `.npy` files, which stay on disk."""
        return cls([np.load(path, mmap_mode="r") for path in paths])

    def __len__(self) -> int:
        return self.shape[0]

    def __array__(self, dtype: np.dtype | None = None, copy: bool | None = None) -> np.ndarray:
        whole = np.concatenate(self._parts)
        return whole if dtype is None else whole.astype(dtype, copy=False)

    def __getitem__(self, index: slice | np.ndarray) -> np.ndarray:
        """Return a copy of the rows of a slice, of indices `(N,)`, or of a mask `(len,)` bool."""
        if isinstance(index, slice):
            index = np.arange(*index.indices(len(self)))
        index = np.asarray(index)
        if index.dtype == np.bool_:
            index = np.flatnonzero(index)
        if index.size and not -len(self) <= index.min() <= index.max() < len(self):
            raise IndexError(f"rows {index.min()} to {index.max()}; allowed are {-len(self)} to {len(self) - 1}")
        index = np.where(index < 0, index + len(self), index)
        part_of = np.searchsorted(self._ends, index, side="right")
        result = np.empty((len(index), *self.shape[1:]), self.dtype)
        for part in np.unique(part_of):
            rows = part_of == part
            result[rows] = self._parts[part][index[rows] - (self._ends[part] - len(self._parts[part]))]
        return result
