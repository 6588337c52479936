"""Set before any test imports numpy or torch: one thread a process, since the tests themselves are run side by side."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")
