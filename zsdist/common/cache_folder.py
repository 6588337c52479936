"""Folder of everything that is computed once and kept: exported networks, compiled code, fonts.

It is `$ZSDIST_CACHE`; else `~/.cache/zsdist`; where the home folder is unknown or cannot be written, as in a container
that runs as another user, `zsdist-cache-UID` in the folder for temporary files. Deleting it costs a minute.
"""

import os
import stat
import tempfile
from pathlib import Path

from zsdist.errors import CacheError

VARIABLE = "ZSDIST_CACHE"
NUMBA_VARIABLE, MATPLOTLIB_VARIABLE = "NUMBA_CACHE_DIR", "MPLCONFIGDIR"
PROBE_BYTES = 2**16


def cache_folder() -> Path:
    """Return the folder of caches, an absolute path. That of the variable may not exist and may not be writable.

    Raises:
        CacheError: the variable names a home folder that is not known; or it is not set, and neither the home folder
            nor that for temporary files can be written.
    """
    if stated := os.environ.get(VARIABLE):
        try:
            return Path(stated).expanduser().absolute()
        except RuntimeError as error:
            raise CacheError(
                f"the environment variable {VARIABLE} is {stated!r}, and that home folder is not known; "
                "allowed is the path of a folder"
            ) from error
    home = _home()
    tried = [] if home is None else [home / ".cache" / "zsdist"]
    if tried and is_writable(tried[0]):
        return tried[0]
    temporary = _temporary()
    if temporary is not None and _is_own(temporary) and is_writable(temporary):
        return temporary
    places = " nor ".join(map(str, [*tried, temporary or "a folder for temporary files"]))
    raise CacheError(
        f"no cache can be written: neither {places}; set the environment variable {VARIABLE} to a folder that you can "
        "write"
    )


def compiled_code_folder() -> Path | None:
    """Return the folder of compiled code: `$NUMBA_CACHE_DIR`, else one in the cache; None where none can be written."""
    try:
        stated = os.environ.get(NUMBA_VARIABLE)
        folder = Path(stated).absolute() if stated else cache_folder() / f"numba-{os.getuid()}"
    except CacheError:
        return None
    return folder if is_writable(folder) else None


def prepare_matplotlib() -> None:
    """Move the settings and fonts of matplotlib into the cache where it could not write its own folder."""
    home = _home()
    if MATPLOTLIB_VARIABLE in os.environ or (home is not None and os.access(home, os.W_OK | os.X_OK)):
        return
    try:
        folder = cache_folder() / "matplotlib"
    except CacheError:
        return  # matplotlib then says so itself
    if is_writable(folder):
        os.environ[MATPLOTLIB_VARIABLE] = str(folder)


def is_temporary(folder: Path) -> bool:
    """Return whether a folder is the last choice, in the folder for temporary files."""
    return folder == _temporary()


def is_writable(folder: Path) -> bool:
    """Return whether files can be written in a folder, which is made if it does not exist."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder, buffering=0) as file:
            return file.write(bytes(PROBE_BYTES)) == PROBE_BYTES  # fewer on a full disk
    except OSError:
        return False


def _home() -> Path | None:
    try:
        return Path.home()
    except RuntimeError:  # no variable HOME, and a user without an entry in the machine's list
        return None


def _temporary() -> Path | None:
    try:
        return Path(tempfile.gettempdir()).absolute() / f"zsdist-cache-{os.getuid()}"
    except FileNotFoundError:  # no folder for temporary files can be written
        return None


def _is_own(folder: Path) -> bool:
    """Return whether a folder in a place that all users may write is this user's alone; it is made if it is missing."""
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022
