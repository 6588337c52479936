"""Episodes on file, one JSON line each, with the hashes of what they depend on: measured once, not driven again."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from zsdist.errors import RunError
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.fingerprint import EQUIVALENT_CODE, code_sha256, entrant_sha256, equivalent
from zsdist.evaluation.records import EpisodeRecord
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Outcome, Pose

_RECORD = {item.name for item in fields(EpisodeRecord)}
_NATURAL = ("index", "seed", "steps", "shield_changes")
_BEGINNING = b'{"code": "'  # of a line, however little of it was written
_ABOUT = ("code", "entrant", "policy", "variant", "weights_sha256", "shielded", "scenes", "seed", "index", "scene_hash")


@dataclass(frozen=True)
class Line:
    """One line of the file: an episode's `record`, and `about` it the hashes and what was asked for."""

    about: Mapping[str, Any]
    record: EpisodeRecord


class EpisodeStore:
    """The episodes of one evaluation in a file that may hold those of others.

    Args:
        file: is made where it is not there.
        contender: who drives.
        policy: what the result calls it.
        weights_sha256: of its networks.
        scenes: what was asked for.
        seed: of scenes and drivers.
        chosen: the scenes themselves.
        equivalents: file that lists equivalent code, see `fingerprint.equivalent`.

    Attributes:
        known: episodes on file, by their place among the chosen scenes, measured with the same or
            equivalent code, the same entrant and seed.
        stale: lines of the same policy, variant and scenes that are not: of other code, weights or settings.

    Raises:
        RunError: the file holds something else, or cannot be written.
    """

    def __init__(
        self,
        file: Path,
        contender: Contender,
        policy: str,
        weights_sha256: str | None,
        scenes: str,
        seed: int,
        chosen: list[Scene],
        equivalents: Path = EQUIVALENT_CODE,
    ) -> None:
        self._file = file
        asked = {
            "policy": policy,
            "variant": contender.variant,
            "shielded": contender.shielded,
            "scenes": scenes,
            "seed": seed,
        }
        code, who = code_sha256(), entrant_sha256(contender)
        codes = equivalent(code, equivalents)
        self._about = {"code": code, "entrant": who, **asked, "weights_sha256": weights_sha256}
        self._hashes = [scene.hash() for scene in chosen]
        self.known: dict[int, EpisodeRecord] = {}
        self.stale = 0
        for line in self._begin():
            about, index = line.about, line.about["index"]
            same = about["code"] in codes and (about["entrant"], about["seed"]) == (who, seed)
            if same and index < len(chosen) and about["scene_hash"] == self._hashes[index]:
                self.known[index] = line.record
            elif not same and all(about[key] == value for key, value in asked.items()):
                self.stale += 1

    def _begin(self) -> list[Line]:
        """What is on file; what was cut off as it was written is taken out of it, so that the next line is whole."""
        if not self._file.exists():
            return []
        lines, size = _read(self._file)
        try:
            if size < self._file.stat().st_size:
                os.truncate(self._file, size)
        except OSError as error:
            raise _unwritable(self._file, error) from error
        return lines

    def add(self, index: int, record: EpisodeRecord) -> None:
        """Writes one episode to the file."""
        fields_ = asdict(record) | {"poses": [[round(value, 4) for value in pose] for pose in record.poses]}
        line = {**self._about, "index": index, "scene_hash": self._hashes[index], **fields_}
        try:
            with self._file.open("a") as out:
                out.write(json.dumps(line, allow_nan=False) + "\n")
        except OSError as error:
            raise _unwritable(self._file, error) from error


def read(file: Path) -> list[Line]:
    """All lines of a file; a last line that was cut off, or is being written, is left out.

    Raises:
        RunError: it cannot be read, or holds something else.
    """
    return _read(file)[0]


def _read(file: Path) -> tuple[list[Line], int]:
    """The lines of a file that are whole, and how many bytes they take."""
    try:
        content = file.read_bytes()
        size = content.rfind(b"\n") + 1
        texts = content[:size].decode().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RunError(f"episodes cannot be read from {file}: {error}") from error
    rest = content[size:]
    if rest[: len(_BEGINNING)] != _BEGINNING[: len(rest)]:
        raise RunError(f"{file} ends with what is no episode of an evaluation; allowed are lines that --out wrote")
    return [_line(text, f"{file}, line {number}") for number, text in enumerate(texts, 1)], size


def _unwritable(file: Path, error: OSError) -> RunError:
    return RunError(f"episodes cannot be written to {file}: {error.strerror or error}")


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no number of JSON")


def _line(text: str, place: str) -> Line:
    try:
        told = json.loads(text, parse_constant=_refuse)
        for name in _NATURAL:
            if type(told[name]) is not int or told[name] < 0:
                raise ValueError(f"{name} is {told[name]!r}; allowed is a natural number")
        record = {name: told[name] for name in _RECORD}
        record |= {
            "outcome": Outcome(record["outcome"]),
            "decision_ms": tuple(record["decision_ms"]),
            "poses": tuple(Pose(*map(float, pose)) for pose in record["poses"]),
        }
        return Line({name: told[name] for name in _ABOUT}, EpisodeRecord(**record))
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(
            f"{place} is no episode of an evaluation ({error}); allowed are lines that --out wrote"
        ) from error
