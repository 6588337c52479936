"""The C library's allocator, told to keep what it has been given back."""

import ctypes
import sys

KEEP_BYTES = 32 * 2**20  # blocks up to so large are kept for the next; the most that glibc takes
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of malloc.h


def keep_freed_memory() -> None:
    """Has large blocks come from memory that this process had before; does nothing where the C library is not glibc.

    A batch's columns are megabytes, made and freed many times a second. By default each is asked of the kernel anew,
    which clears it page by page: up to a third of what a replay's batches cost.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(_MMAP_THRESHOLD, KEEP_BYTES)
            mallopt(_TRIM_THRESHOLD, 2 * KEEP_BYTES)
