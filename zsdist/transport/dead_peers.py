"""Connections to peers that are cut off, which zenoh alone may hold for minutes.

Zenoh gives a peer up that is silent for a lease. Over TLS, where what was sent to it has filled the socket's buffer, it
does so only once that has room again. After a cut of 30 s this was 24 s after the network was back, since the kernel
waits twice as long after each trial to send. So buffers here hold what is sent in a lease, and the kernel itself gives
a peer up that has acknowledged nothing for so long. Zenoh has no setting for the latter.
"""

import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path

from zsdist.common import folders

OPEN_FILES = Path("/proc/self/fd")  # of this process, where the system lists them
SEND_BUFFER_BYTES = 2**20  # of each connection; Linux doubles it, and allows no more than net.core.wmem_max


def give_up_after(port: int, seconds: float) -> int:
    """Let the kernel end each connection at a port that a peer has not acknowledged for some time.

    Connections that are made later inherit this from the listening socket. It does nothing where the system has no
    `TCP_USER_TIMEOUT`, or lists no open files in /proc.

    Args:
        port: port at which this process listens.
        seconds: time since the oldest byte that was not acknowledged was sent.

    Returns:
        The number of listening sockets.
    """
    option = getattr(socket, "TCP_USER_TIMEOUT", None)
    if option is None:
        return 0
    found = 0
    for one in open_sockets():
        if one.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN) and one.getsockname()[1] == port:
            one.setsockopt(socket.IPPROTO_TCP, option, int(1000 * seconds))
            found += 1
    return found


def open_sockets() -> Iterator[socket.socket]:
    """Yield every TCP socket of this process, each under a descriptor of its own that is closed after use."""
    for entry in folders.numbered(OPEN_FILES):
        try:
            own = os.dup(int(entry.name))
        except OSError:  # closed meanwhile, as that of the list itself is
            continue
        if not stat.S_ISSOCK(os.fstat(own).st_mode):
            os.close(own)
            continue
        with socket.socket(fileno=own) as one:
            if one.family in (socket.AF_INET, socket.AF_INET6) and one.type == socket.SOCK_STREAM:
                yield one
