"""Cache of readings of pictures, by scene and lattice state, for all runs of a user on a machine.

The cache is one file of fixed size, mapped into memory and divided into sets of a few slots. A slot has a checksum and
no lock. A slot that is torn, by two writers at once or by a crash during a write, counts as empty.
"""

import errno
import mmap
import os
import tempfile
import weakref
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from zsdist.common import folders, locks
from zsdist.errors import ConfigError, RunError
from zsdist.types import LatticeState
from zsdist.vision.rays import BINS, RAYS
from zsdist.vision.reading import Reading

SHAPES = ((3, BINS), (3,), (RAYS, BINS))  # shapes of the parts of one picture's `Reading`
LENGTHS = tuple(int(np.prod(shape)) for shape in SHAPES)
_PARTS = [slice(sum(LENGTHS[:part]), sum(LENGTHS[: part + 1])) for part in range(len(LENGTHS))]
KEY_BYTES, CHECK_BYTES = 16, 8
HEAD_BYTES = KEY_BYTES + CHECK_BYTES
SLOT_BYTES = HEAD_BYTES + 2 * sum(LENGTHS)
WAYS = 4  # number of slots of a set
SET_BYTES = WAYS * SLOT_BYTES
PREFIX = f"zsdist-readings-{os.getuid()}-"


class ReadingCache:
    """Readings by (vision model, scene, cell, heading), in float16, in a file of at most `size_bytes`.

    The file is in the machine's folder for temporary files: several machines may share any other folder, and their
    mapped pages do not agree. The file stays, so that a later or parallel run in the same scenes finds the readings.
    Its space is reserved when it is created, since a mapped file on a full disk kills its writer. Each process holds a
    shared lock on its file, which ends with the process. An unused file of another size is removed, so a user has one
    file unless runs with different sizes are active at once. A copy, or a cache from a pickle, opens the file anew.

    Args:
        size_bytes: greatest size of the file in bytes.
        vision: text that names everything else that a reading depends on; readings with another text are not found.

    Raises:
        ConfigError: `size_bytes` is too small for one set of slots.
        RunError: the file cannot be created.
    """

    def __init__(self, size_bytes: int, vision: str) -> None:
        self._arguments = (size_bytes, vision)
        self._sets = size_bytes // SET_BYTES
        if self._sets < 1:
            raise ConfigError(f"vision.cache_bytes is {size_bytes}; allowed are 0 (no cache) and {SET_BYTES} or more")
        size = self._sets * SET_BYTES
        try:
            path = Path(tempfile.gettempdir(), f"{PREFIX}{size}")
        except FileNotFoundError as error:
            raise RunError(
                f"vision.cache_bytes is {size_bytes}: no folder for temporary files can be written; "
                "set the environment variable TMPDIR to one, or vision.cache_bytes to 0 (no cache)"
            ) from error
        _remove_others(path)
        try:
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
            self._close_file = weakref.finalize(self, os.close, file)
            if os.fstat(file).st_uid != os.getuid():  # the name can be guessed and the folder is shared
                raise PermissionError(errno.EPERM, "it belongs to another user")
            locks.share(file)
            os.posix_fallocate(file, 0, size)
            self._memory = mmap.mmap(file, size)
        except OSError as error:
            raise RunError(
                f"vision.cache_bytes is {size_bytes}: {path} cannot be created ({error.strerror or error}); "
                "allowed is a size that fits on the disk, or 0 (no cache)"
            ) from error
        self._vision = blake2b(vision.encode(), digest_size=KEY_BYTES).digest()
        self._kept = 0

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._arguments

    def find(self, scene: str, state: LatticeState) -> Reading | None:
        """Return the reading at a lattice state of a scene, named by its hash; None if it is unknown or torn."""
        key = self._key(scene, state)
        for begin in self._slots(key):
            slot = self._memory[begin : begin + SLOT_BYTES]  # a copy: the bytes that are checked are those returned
            if slot[:KEY_BYTES] == key and slot[KEY_BYTES:HEAD_BYTES] == _check(key, slot[HEAD_BYTES:]):
                return _unpacked(slot[HEAD_BYTES:])
        return None

    def keep(self, scene: str, state: LatticeState, reading: Reading) -> Reading:
        """Store the reading of one picture, with parts of `SHAPES`, and return it as `find` will return it."""
        key = self._key(scene, state)
        content = np.concatenate([np.ravel(part) for part in reading]).astype(np.float16).tobytes()
        begins = self._slots(key)
        held = [self._memory[begin : begin + KEY_BYTES] for begin in begins]
        self._kept += 1
        wanted = next((one for one in (key, bytes(KEY_BYTES)) if one in held), held[self._kept % WAYS])
        begin = begins[held.index(wanted)]
        self._memory[begin : begin + SLOT_BYTES] = key + _check(key, content) + content
        return _unpacked(content)

    def close(self) -> None:
        """Close the file, which stays on disk; closing again does nothing."""
        self._memory.close()
        self._close_file()

    def _key(self, scene: str, state: LatticeState) -> bytes:
        position = f"{scene}/{state.ix}/{state.iy}/{state.heading}"
        return blake2b(position.encode(), digest_size=KEY_BYTES, key=self._vision).digest()

    def _slots(self, key: bytes) -> range:
        begin = int.from_bytes(key[:8], "little") % self._sets * SET_BYTES
        return range(begin, begin + SET_BYTES, SLOT_BYTES)


def _remove_others(kept: Path) -> None:
    """Remove the cache files of this user that no living process uses, except `kept`."""
    for path in folders.visible(kept.parent, f"{PREFIX}*"):
        if path == kept:
            continue
        try:
            file = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
        except OSError:  # another process removed it, or it is no file of ours
            continue
        try:
            if locks.is_unused(file):
                path.unlink(missing_ok=True)
        except OSError:  # no file of ours
            pass
        finally:
            os.close(file)


def _check(key: bytes, content: bytes) -> bytes:
    return blake2b(content, digest_size=CHECK_BYTES, key=key).digest()


def _unpacked(content: bytes) -> Reading:
    """Return the reading in a slot's content, float32, with distributions normalised to sum 1."""
    flat = np.frombuffer(content, np.float16).astype(np.float32)
    clearance, dynamic, rays = (flat[part].reshape(shape) for part, shape in zip(_PARTS, SHAPES, strict=True))
    clearance /= np.add.reduce(clearance, -1, keepdims=True)
    rays /= np.add.reduce(rays, -1, keepdims=True)
    return Reading(clearance, dynamic, rays)
