"""Locks of folders and files that only one process may write.

A lock is one of the system (`flock`) on a small file beside what it guards. It ends with its process, however that
ends; processes that are started meanwhile do not inherit it. Over NFS it holds for all machines that mount the folder
with locks, which is the default. Where a file system has no locks at all, a process goes on without, and says so.
"""

import errno
import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from zsdist.common.plain_lines import say
from zsdist.errors import RunError

LOCK_FILE = ".lock"  # in a folder; beside a file: `.NAME.lock`
NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)
IN_USE = (errno.EWOULDBLOCK, errno.EACCES)


@contextmanager
def held(path: Path, what: str) -> Iterator[None]:
    """Hold the lock of a folder that exists, or of a file that may not exist yet.

    Args:
        path: folder or file.
        what: name of it in errors, such as `run directory runs/x`.

    Raises:
        RunError: another process holds it, or nothing can be written there.
    """
    if path.exists() and not path.is_dir() and not path.is_file():
        yield  # a pipe or a device, which is no one's own
        return
    place = _place_of(path)
    descriptor = _acquire(place, what)
    try:
        yield
    finally:
        with suppress(OSError):  # its folder may be gone, or the disk may have become read-only
            place.unlink()  # while it is held: whoever has opened it too finds that it has lost its name
        os.close(descriptor)


def check_free(path: Path, what: str) -> None:
    """Raise `RunError` where another process holds the lock of a folder or file; nothing is written."""
    place = _place_of(path)
    try:
        descriptor = os.open(place, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return  # nobody uses it, or whoever writes it will say why it cannot
    try:
        _lock(descriptor, place, what)
    finally:
        os.close(descriptor)


def is_held(folder: Path) -> bool | None:
    """Return whether a process holds the lock of a folder; None where that cannot be told."""
    try:
        descriptor = os.open(folder / LOCK_FILE, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:  # there is none, or it cannot be read
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return True if error.errno in IN_USE else None
    finally:
        os.close(descriptor)
    return False


def share(descriptor: int) -> None:
    """Lock an open file together with others; raise `OSError` where that is impossible."""
    fcntl.flock(descriptor, fcntl.LOCK_SH)


def is_unused(descriptor: int) -> bool:
    """Lock an open file alone, and return whether that was possible."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _place_of(path: Path) -> Path:
    """Return the lock file of a folder or a file."""
    return path / LOCK_FILE if path.is_dir() else path.resolve().with_name(f".{path.resolve().name}.lock")


def _acquire(place: Path, what: str) -> int:
    while True:
        try:
            descriptor = _open(place)
        except OSError as error:
            raise RunError(f"{what} cannot be written: {error.strerror}") from error
        locked = False
        try:
            locked = _lock(descriptor, place, what)
            if _is_at(descriptor, place):
                if not locked:
                    say(f"{what} has no locks on its file system; see to it that no other process uses it", error=True)
                if os.access(place, os.W_OK):  # else it is left of another user's process
                    os.ftruncate(descriptor, 0)
                    os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode())
                return descriptor
        except BaseException as error:
            if locked and isinstance(error, OSError):  # on a full disk; without the lock it may be another process's
                with suppress(OSError):
                    place.unlink()
            os.close(descriptor)
            if isinstance(error, OSError):
                raise RunError(f"{what} cannot be written: {error.strerror}") from error
            raise
        os.close(descriptor)  # its holder has just ended and removed it


def _open(place: Path) -> int:
    """Open a lock file, made if missing; one that is left of another user's process is opened to be read."""
    try:
        return os.open(place, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except PermissionError:
        return os.open(place, os.O_RDONLY | os.O_CLOEXEC)


def _lock(descriptor: int, place: Path, what: str) -> bool:
    """Lock an open lock file; return False where there are no locks, raise `RunError` where another process has it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in IN_USE:
            holder = os.pread(descriptor, 200, 0).decode(errors="replace") or "another process"
            raise RunError(f"{what} is in use by {holder}; wait until it has ended, or stop it") from error
        if error.errno not in NO_LOCKS:
            raise
        return False
    return True


def _is_at(descriptor: int, place: Path) -> bool:
    """Return whether an open file still has its name."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(place))
    except FileNotFoundError:
        return False
