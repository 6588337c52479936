"""PyBullet without the line that it writes to standard error at import; commands keep that stream for messages."""

import os
import sys


def _import_quietly() -> None:
    sys.stderr.flush()
    saved, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        import pybullet  # noqa: F401
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(null)


_import_quietly()

import pybullet  # noqa: E402

__all__ = ["pybullet"]
