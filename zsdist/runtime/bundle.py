"""Bundle of an exported policy: its files, their hashes, and the manifest that says what they mean."""

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from zsdist import __version__
from zsdist.config import Config
from zsdist.errors import BundleError, ConfigError
from zsdist.planning.grid import Grid
from zsdist.runtime.manifest import (
    FORMAT,
    BundleAction,
    BundleCamera,
    BundleFootprint,
    BundleManifest,
    configuration,
)
from zsdist.types import Level

MANIFEST_FILE = "manifest.json"
VISION_FILE = "vision.onnx"
NETWORK_FILES = {Level.HIGH: "high.onnx", Level.LOW: "low.onnx"}
PARITY_FILE = "parity.safetensors"
CARD_FILE = "README.md"
FILES = (VISION_FILE, *NETWORK_FILES.values(), PARITY_FILE, CARD_FILE)
"""Files of a bundle beside its manifest, which has the hash of each."""

_AGAIN = "export the policy again, or copy the whole folder again"


@dataclass(frozen=True)
class Bundle:
    """Bundle in a folder, whose files have been checked. Use `Bundle.load`.

    Attributes:
        folder: folder of the files.
        manifest: content of `manifest.json`.
        config: configuration that the policy decides under; settings without influence on that have their defaults.
    """

    folder: Path
    manifest: BundleManifest
    config: Config

    @classmethod
    def load(cls, folder: Path) -> "Bundle":
        """Return the bundle in a folder, with the hash of every file checked.

        Raises:
            BundleError: the folder or a file is missing, damaged, or of another version of the format or of zsdist.
        """
        manifest = _manifest(folder)
        for name in FILES:
            if name not in manifest.files:
                raise BundleError(f"bundle {folder}: {MANIFEST_FILE} has no hash of {name}; {_AGAIN}")
        for name, expected in manifest.files.items():
            _check_file(folder, name, expected)
        try:
            return cls(folder, manifest, configuration(manifest))
        except ConfigError as error:
            raise BundleError(f"bundle {folder}: settings in {MANIFEST_FILE}: {error}; {_AGAIN}") from error

    @property
    def camera(self) -> BundleCamera:
        """Camera that the policy expects."""
        return self.manifest.camera

    @property
    def footprint(self) -> BundleFootprint:
        """Box that the policy keeps free."""
        return self.manifest.footprint

    @property
    def actions(self) -> tuple[BundleAction, ...]:
        """Actions, in the order of `zsdist.types.Action`."""
        return self.manifest.actions

    @cached_property
    def grid(self) -> Grid:
        """Planning grid, in the middle of the arena."""
        return Grid.from_config(self.config.grid)


def _manifest(folder: Path) -> BundleManifest:
    """Return the manifest of a bundle; raise `BundleError` where it is missing, damaged or of another version."""
    file = folder / MANIFEST_FILE
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise BundleError(
            f"bundle {file} cannot be read: {error.strerror or error}; allowed is a folder that `zsdist export` made"
        ) from error
    except (ValueError, RecursionError) as error:
        raise BundleError(f"bundle {file} is damaged: {error}; {_AGAIN}") from error
    _check_versions(file, content)
    try:
        return BundleManifest.model_validate_json(json.dumps(content))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise BundleError(f"bundle {file} is damaged: {key}: {first['msg']}; {_AGAIN}") from error


def _check_versions(file: Path, content: Any) -> None:
    found = content.get("format") if isinstance(content, dict) else None
    if found != FORMAT or isinstance(found, bool):
        raise BundleError(
            f"bundle {file} has the format {found!r}; zsdist {__version__} reads format {FORMAT}: export the policy "
            "with this version, or install the one that made the bundle"
        )
    maker = content.get("zsdist")
    if maker != __version__:
        raise BundleError(
            f"bundle {file} was made by zsdist {maker}; this is zsdist {__version__}, which may decide otherwise: "
            f"install zsdist {maker}, or export the policy with {__version__}"
        )


def sha256(path: Path) -> str:
    """Return the hash of a file as a manifest has it; raise `OSError` where it cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check_file(folder: Path, name: str, expected: str) -> None:
    if Path(name).name != name:
        raise BundleError(f"bundle {folder}: {MANIFEST_FILE} names the file {name!r}; allowed is a name in the folder")
    try:
        found = sha256(folder / name)
    except OSError as error:
        raise BundleError(f"bundle {folder}: {name} cannot be read: {error.strerror or error}; {_AGAIN}") from error
    if found != expected:
        raise BundleError(
            f"bundle {folder}: {name} is damaged: its SHA-256 is {found[:16]}..., and {MANIFEST_FILE} has "
            f"{expected[:16]}...; {_AGAIN}"
        )
