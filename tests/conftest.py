"""Settings and fixtures of all tests.

Each process computes in one thread, since tests run side by side. This is set before any test imports numpy or torch.
"""

import os
import signal
import tempfile

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")


@pytest.fixture(scope="session", autouse=True)
def own_temporary_folder(tmp_path_factory):
    """Replace the machine's folder for temporary files, here and in child processes.

    Tests then neither find readings cached by earlier runs nor leave any. Ray gets a folder with a short name, in which
    the paths of its sockets fit.
    """
    with (
        pytest.MonkeyPatch.context() as patch,
        tempfile.TemporaryDirectory(dir="/tmp", ignore_cleanup_errors=True) as short,
    ):
        patch.setenv("RAY_TMPDIR", short)
        folder = str(tmp_path_factory.mktemp("machine"))
        patch.setenv("TMPDIR", folder)
        patch.setattr(tempfile, "tempdir", folder)
        yield


@pytest.fixture
def hears_ctrl_c():
    """Let Ctrl-C reach this process and its children, even if the tests were started with SIGINT ignored (by `&`)."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def small_bundle(tmp_path_factory):
    """Return the folder of a small bundle, which must not be changed."""
    from bundles import write_bundle

    return write_bundle(tmp_path_factory.mktemp("bundle") / "small")
