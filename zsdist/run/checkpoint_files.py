"""Files of checkpoints: each is checked when it is read, and one that is damaged gives way to the one before it."""

import hashlib
import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zsdist.common import folders
from zsdist.config import Notify
from zsdist.errors import DamagedError, DecodeError, RunError
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire import codec
from zsdist.wire.messages import State

MANIFEST = "manifest.json"
DAMAGED = ".damaged"  # end of the name of a checkpoint that was found damaged and set aside
# Manifests of earlier versions have these entries and no checksum of their own.
_WITHOUT_CHECKSUM = {"zsdist", "episodes", "vision", "sha256", "tensorboard"}
_SEALED = re.compile(rb'(?P<checked>.*),\n "manifest_sha256": "(?P<digest>[0-9a-f]{64})"\n\}', re.DOTALL)


def checkpoints(folder: Path) -> list[Path]:
    """Return the complete checkpoints of a run directory, oldest first; a file in them may be damaged."""
    return [path for path in folders.numbered(folder / "checkpoints") if (path / MANIFEST).is_file()]


def has_checkpoint(folder: Path) -> bool:
    """Return whether a run directory holds a checkpoint, whole or damaged."""
    return bool(_with_files(folder))


def newest_checkpoint(folder: Path) -> Path:
    """Return the newest checkpoint of a run directory; raise `RunError` where there is none."""
    found = checkpoints(folder)
    if not found:
        raise RunError(f"run directory {folder} holds no checkpoint to resume from")
    return found[-1]


def newest_whole(folder: Path, notify: Notify | None = None) -> tuple[Path, dict[str, State], list[Path]]:
    """Return the newest checkpoint of a run directory that is not damaged.

    Args:
        folder: run directory.
        notify: called with one line about each damaged checkpoint that is newer.

    Returns:
        Its path, the states of all roles in it, and the damaged ones that are newer, newest first.

    Raises:
        RunError: there is no checkpoint, or all are damaged, or one cannot be read.
    """
    damaged: dict[Path, DamagedError] = {}
    for path in reversed(_with_files(folder)):
        try:
            states = read_checkpoint(path)
        except DamagedError as error:
            damaged[path] = error
            continue
        for error in damaged.values() if notify else ():
            notify(f"{error}; the one before it is used, {path.name}")
        return path, states, list(damaged)
    if not damaged:
        raise RunError(f"run directory {folder} holds no checkpoint to resume from")
    newest = next(iter(damaged.values()))
    raise DamagedError(
        f"no checkpoint in {folder / 'checkpoints'} is whole, of {len(damaged)}; the newest: {newest}; copy one back "
        "from a backup, or begin a new run"
    ) from newest


def set_aside(damaged: list[Path]) -> None:
    """Rename damaged checkpoints, so that they count no more and are kept for people to look at.

    Raises:
        RunError: one cannot be renamed.
    """
    for path in damaged:
        aside = path.with_name(path.name + DAMAGED)
        try:
            shutil.rmtree(aside, ignore_errors=True)
            path.rename(aside)
        except OSError as error:
            raise RunError(f"checkpoint {path} is damaged and cannot be renamed: {error.strerror}") from error


def read_checkpoint(checkpoint: Path) -> dict[str, State]:
    """Return the states of all roles in a checkpoint folder, each checked against the manifest's hash.

    Raises:
        DamagedError: a file is missing or damaged.
        RunError: a file cannot be read.
    """
    states = {}
    for name, digest in _hashes(checkpoint).items():
        path = checkpoint / f"{name}.state"
        payload = _read(path)
        if hashlib.sha256(payload).hexdigest() != digest:
            raise DamagedError(f"checkpoint file {path} is damaged: its SHA-256 is not the manifest's")
        try:
            states[name] = codec.decode(payload, expect=State)
        except DecodeError as error:
            raise DamagedError(f"checkpoint file {path} is damaged: {error}") from error
    return states


def read_vision(checkpoint: Path) -> VisionIdentity:
    """Return the vision model that a checkpoint's policy was trained with; raise `RunError` where it names none."""
    try:
        return VisionIdentity.from_json(read_manifest(checkpoint)["vision"])
    except (ValueError, KeyError, TypeError) as error:
        path = checkpoint / MANIFEST
        raise RunError(f"checkpoint file {path} does not name the vision model of its policy: {error}") from error


def manifest_bytes(manifest: Mapping[str, Any]) -> bytes:
    """Return the content of `manifest.json`: the entries, and last the SHA-256 of all bytes before it."""
    checked = json.dumps(manifest, indent=1).encode().removesuffix(b"\n}")
    return checked + f',\n "manifest_sha256": "{hashlib.sha256(checked).hexdigest()}"\n}}'.encode()


def read_manifest(checkpoint: Path) -> dict[str, Any]:
    """Return the content of a checkpoint's manifest; one of an earlier version has no checksum of its own.

    Raises:
        DamagedError: it is missing or damaged.
        RunError: it cannot be read.
    """
    path = checkpoint / MANIFEST
    content = _read(path)
    try:
        manifest = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise DamagedError(f"checkpoint file {path} is damaged: {error}") from error
    if not isinstance(manifest, dict):
        raise DamagedError(f"checkpoint file {path} is damaged: it is no JSON object")
    sealed = _SEALED.fullmatch(content)
    if sealed is None and not set(manifest) <= _WITHOUT_CHECKSUM:
        raise DamagedError(f"checkpoint file {path} is damaged: its checksum is not where it belongs")
    if sealed and hashlib.sha256(sealed["checked"]).hexdigest().encode() != sealed["digest"]:
        raise DamagedError(f"checkpoint file {path} is damaged: its SHA-256 is not the one at its end")
    return manifest


def _hashes(checkpoint: Path) -> dict[str, str]:
    """Return the SHA-256 of each state by the name of its role."""
    hashes = read_manifest(checkpoint).get("sha256")
    if not isinstance(hashes, dict) or not hashes:
        raise DamagedError(f"checkpoint file {checkpoint / MANIFEST} is damaged: it names no states")
    return hashes


def _with_files(folder: Path) -> list[Path]:
    """Return the checkpoints of a run directory of which any file is left, oldest first."""
    return [
        path
        for path in folders.numbered(folder / "checkpoints")
        if (path / MANIFEST).is_file() or folders.visible(path, "*.state")
    ]


def _read(path: Path) -> bytes:
    """Return the content of a file of a checkpoint; a missing one is damage, one that may not be read is not."""
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise DamagedError(f"checkpoint file {path} is missing") from error
    except OSError as error:
        raise RunError(f"checkpoint file {path} cannot be read: {error.strerror}") from error
