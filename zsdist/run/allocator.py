"""Handling of freed memory by the C library's allocator: it keeps it, or returns it to the system."""

import ctypes
import sys

KEEP_BYTES = 32 * 2**20  # blocks up to this size are kept; the largest value that glibc accepts
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of malloc.h


def keep_freed_memory() -> None:
    """Make the allocator reuse large freed blocks; do nothing where the C library is not glibc.

    The columns of a batch take megabytes, allocated and freed many times a second. By default the kernel provides each
    block anew and clears it page by page, which takes up to a third of the time of a replay's batches.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(_MMAP_THRESHOLD, KEEP_BYTES)
            mallopt(_TRIM_THRESHOLD, 2 * KEEP_BYTES)


def return_freed_memory() -> None:
    """Make the allocator return what it can to the system; do nothing where the C library is not glibc."""
    if sys.platform == "linux":
        malloc_trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if malloc_trim is not None:
            malloc_trim(0)
