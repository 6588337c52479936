"""Set before any test imports numpy or torch: one thread a process, since the tests themselves are run side by side."""

import os
import signal
import tempfile

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")


@pytest.fixture(scope="session", autouse=True)
def own_temporary_folder(tmp_path_factory):
    """The machine's folder for temporary files, here and in processes that are started: what is remembered from
    earlier runs is not for tests to find, nor theirs to leave."""
    with pytest.MonkeyPatch.context() as patch:
        folder = str(tmp_path_factory.mktemp("machine"))
        patch.setenv("TMPDIR", folder)
        patch.setattr(tempfile, "tempdir", folder)
        yield


@pytest.fixture
def hears_ctrl_c():
    """Ctrl-C reaches this process and those it starts, also where the tests were started deaf to it, as by a `&`."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
