import resource
import sys
from pathlib import Path

import numpy as np
import pytest

from zsdist.run.allocator import KEEP_BYTES, keep_freed_memory, return_freed_memory

RESIDENT = Path("/proc/self/statm")


def made_and_freed():
    for block in [np.ones(KEEP_BYTES // 2, np.uint8) for _ in range(3)]:
        block[0] = 0


@pytest.mark.skipif(sys.platform != "linux", reason="only glibc has this setting")
def test_freed_large_blocks_are_used_again():
    keep_freed_memory()
    made_and_freed()
    keep_freed_memory()  # a second call does no harm
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(10):
        made_and_freed()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before < KEEP_BYTES // 4096


@pytest.mark.skipif(sys.platform != "linux", reason="only glibc can return it")
def test_freed_small_blocks_are_returned_on_request():
    blocks = [bytes(1000) for _ in range(50_000)]
    last = bytes(1000)  # holds the end of the heap
    del blocks
    resident = RESIDENT.read_text
    before = int(resident().split()[1])
    return_freed_memory()
    assert int(resident().split()[1]) <= before
    assert len(last) == 1000
