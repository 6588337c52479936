"""Setting of the C library's allocator that makes it keep freed memory."""

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
