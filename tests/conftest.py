"""Set before any test imports numpy or torch: one thread a process, since the tests themselves are run side by side."""

import os
import signal

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")


@pytest.fixture
def hears_ctrl_c():
    """Ctrl-C reaches this process and those it starts, also where the tests were started deaf to it, as by a `&`."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
