"""Division of sequences into batches for models."""

import itertools
from collections.abc import Iterable, Iterator
from typing import Any

BATCH = 16  # number of pictures that a model gets at once


def batched(items: Iterable[Any], size: int) -> Iterator[list[Any]]:
    """Yield lists of `size` items; the last one has the remaining items."""
    iterator = iter(items)
    while batch := list(itertools.islice(iterator, size)):
        yield batch
