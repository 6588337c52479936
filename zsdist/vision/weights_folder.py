"""Folder of vision weights: its files, their origin and their integrity.

`visual_act.json` holds the encoder and camera that the weights are for, how they were made, and the SHA-256 of each
other file; a file that it does not name is ignored. A file is read only when it is requested. Each stage of the
training appends its figures to `training.jsonl`: one JSON object per epoch, with the keys "stage", "epoch" and others.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zsdist.common import atomic_files, places
from zsdist.config import CameraConfig
from zsdist.errors import WeightsError
from zsdist.vision.encoders.base import Encoder

METADATA_FILE = "visual_act.json"
HEAD_FILE = "head.safetensors"
STUDENT_FILE = "student.safetensors"
COMPACT_FILE = "compact.safetensors"
PROJECTION_FILE = "projection.safetensors"
VOCABULARY_FILE = "vocabulary.safetensors"
HISTORY_FILE = "training.jsonl"
VERSION = 2
SHIPPED = Path(__file__).parent / "weights"
CAMERA_KEYS = ("field_of_view_deg", "range_m", "height_m")
"""Camera settings that must be equal in training and in use."""


@dataclass(frozen=True)
class WeightsFolder:
    """Folder of weights with its metadata. Use `read` or `write` to make one.

    Attributes:
        path: path of the folder.
        metadata: "version", "encoder" (name, sha256, and text_sha256 if words were learned), "camera"
            (`CAMERA_KEYS`), "files" (SHA-256 of each), and further entries on how the weights were made.
    """

    path: Path
    metadata: dict[str, Any]

    def has(self, file: str) -> bool:
        """Return whether the metadata names `file`."""
        return file in self.metadata["files"]

    def sha256(self, file: str) -> str:
        """Return the SHA-256 that `file` must have, in hexadecimal; raise `WeightsError` if there is no such file."""
        if not self.has(file):
            raise WeightsError(
                f"weights {self.path} hold no {file}, only {', '.join(self.metadata['files']) or 'nothing'}; "
                "`python -m zsdist.pretrain` makes all files"
            )
        return self.metadata["files"][file]

    def content(self, file: str) -> bytes:
        """Return the bytes of `file`; raise `WeightsError` if it is missing or its hash differs from the metadata's."""
        allowed, path = self.sha256(file), self.path / file
        try:
            content = path.read_bytes()
        except OSError as error:
            raise WeightsError(f"weights {path} cannot be read: {error.strerror or error}") from error
        found = hashlib.sha256(content).hexdigest()
        if found != allowed:
            raise WeightsError(
                f"weights {path} are damaged: {len(content)} bytes of SHA-256 {found[:16]}...; "
                f"allowed is {allowed[:16]}... from {METADATA_FILE}"
            )
        return content

    def history(self) -> list[dict[str, Any]]:
        """Return the figures of each epoch of each stage, in order; raise `WeightsError` if they cannot be read."""
        path = self.path / HISTORY_FILE
        try:
            return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line]
        except OSError as error:
            raise WeightsError(f"history {path} cannot be read: {error.strerror or error}") from error
        except ValueError as error:
            raise WeightsError(f"history {path} is damaged: {error}") from error

    def check_camera(self, camera: CameraConfig) -> None:
        """Raise `WeightsError` unless the weights were trained for a camera with these settings."""
        for key in CAMERA_KEYS:
            if self.metadata["camera"][key] != getattr(camera, key):
                raise WeightsError(
                    f"camera.{key} is {getattr(camera, key)}; weights {self.path} allow "
                    f"{self.metadata['camera'][key]}; `python -m zsdist.pretrain` makes weights for another value"
                )

    def check_encoder(self, encoder: Encoder) -> None:
        """Raise `WeightsError` unless the weights were trained on this encoder, whatever its folder is called."""
        trained = self.metadata["encoder"]
        if trained["sha256"] != encoder.sha256:
            raise WeightsError(
                f"weights {self.path} are for the encoder {trained['name']!r} with weights {trained['sha256'][:16]}; "
                f"the one here is {encoder.name!r} with {encoder.sha256[:16]} (vision.encoder selects it)"
            )


def locate(weights: str) -> Path:
    """Return the folder that `vision.weights` names: "pretrained" is the shipped one, anything else is a path."""
    return SHIPPED if weights == places.WEIGHTS else Path(weights)


def read(path: Path) -> WeightsFolder:
    """Return the folder at `path`; its files are read when they are requested.

    Raises:
        WeightsError: the metadata is missing, damaged, incomplete or of another version.
    """
    file = path / METADATA_FILE
    try:
        metadata = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise WeightsError(
            f"weights {file} cannot be read: {error.strerror or error}; allowed are 'pretrained' and a folder "
            "that `python -m zsdist.pretrain` made, as vision.weights"
        ) from error
    except ValueError as error:
        raise WeightsError(f"weights {file} is damaged: {error}") from error
    version = metadata.get("version") if isinstance(metadata, dict) else None
    if version != VERSION:
        raise WeightsError(f"weights {file} is of version {version!r}; allowed is {VERSION}")
    try:
        _ = [str(metadata["encoder"][key]) for key in ("name", "sha256")]
        _ = [float(metadata["camera"][key]) for key in CAMERA_KEYS]
        if not all(isinstance(sha256, str) for sha256 in dict(metadata["files"]).values()):
            raise TypeError("'files', each with its SHA-256")
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsError(f"weights {file} is damaged: no usable entry {error}") from error
    return WeightsFolder(path, metadata)


def write(path: Path, modules: Mapping[str, bytes], metadata: Mapping[str, Any]) -> WeightsFolder:
    """Write a folder of weights, or replace the files of an existing one; its history stays.

    Each file is replaced atomically and the metadata is written last, so that an interruption leaves a folder that is
    either complete or refused.

    Args:
        path: path of the folder; created if it does not exist.
        modules: content of each file by its name.
        metadata: metadata as in `WeightsFolder`, without "version" and "files".

    Raises:
        WeightsError: the folder cannot be written.
    """
    hashes = {name: hashlib.sha256(content).hexdigest() for name, content in modules.items()}
    full = {**metadata, "version": VERSION, "files": hashes}
    text = json.dumps(full, indent=1) + "\n"
    try:
        path.mkdir(parents=True, exist_ok=True)
        for name, content in (*modules.items(), (METADATA_FILE, text.encode())):
            atomic_files.replace(path / name, content)
    except OSError as error:
        raise WeightsError(f"weights {path} cannot be written: {error.strerror or error}") from error
    return WeightsFolder(path, full)
