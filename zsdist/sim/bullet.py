"""PyBullet: its import, without the line that it writes to standard error, and its clients."""

import gc
import os
import sys
import weakref

from zsdist.errors import SimulationError


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

__all__ = ["Client", "pybullet"]


class Client:
    """PyBullet client (DIRECT: no window), which disconnects when it is closed or nothing refers to it any more.

    It takes about 28 MiB. A forked process has a copy of its own.

    Attributes:
        number: number by which PyBullet's functions know the client.

    Raises:
        SimulationError: the process has as many clients as PyBullet allows.
    """

    def __init__(self) -> None:
        self.number = _connect()
        self._disconnect = weakref.finalize(self, pybullet.disconnect, self.number)

    def close(self) -> None:
        """Disconnect; closing again does nothing."""
        self._disconnect()


def _connect() -> int:
    number = _try_to_connect()
    if number < 0:
        gc.collect()  # disconnects clients that only a cycle of references holds
        number = _try_to_connect()
    if number < 0:
        raise SimulationError(
            "PyBullet allows no further client in this process; close environments and cameras that are not needed, "
            "or use several processes"
        )
    return number


def _try_to_connect() -> int:
    """Return the number of a new client; negative: there are too many."""
    try:
        return int(pybullet.connect(pybullet.DIRECT))
    except pybullet.error:
        return -1
