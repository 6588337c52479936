"""Items in lists of a size, as models take them."""

import itertools
from collections.abc import Iterable, Iterator
from typing import Any

BATCH = 16  # pictures read at once


def batched(items: Iterable[Any], size: int) -> Iterator[list[Any]]:
    """Lists of `size` items, the last of what is left."""
    iterator = iter(items)
    while batch := list(itertools.islice(iterator, size)):
        yield batch
