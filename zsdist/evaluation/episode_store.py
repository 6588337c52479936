"""Store of evaluated episodes as JSON lines, with hashes of all that they depend on, so that none is driven twice."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from zsdist.errors import RunError
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.fingerprint import EQUIVALENT_CODE, code_sha256, contender_sha256, equivalent
from zsdist.evaluation.records import EpisodeRecord
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Outcome, Pose

_RECORD = {item.name for item in fields(EpisodeRecord)}
_NATURAL = ("index", "seed", "steps", "shield_changes")
_BEGINNING = b'{"code": "'  # beginning of every line, also of an incomplete one
_ABOUT = ("code", "entrant", "policy", "variant", "weights_sha256", "shielded", "scenes", "seed", "index", "scene_hash")


@dataclass(frozen=True)
class Line:
    """One line of the file.

    Attributes:
        about: hashes of what the episode depends on, and the evaluation that it belongs to.
        record: the episode.
    """

    about: Mapping[str, Any]
    record: EpisodeRecord


class EpisodeStore:
    """Episodes of one evaluation, in a file that may hold other evaluations too.

    Args:
        file: file of JSON lines; created if it does not exist.
        contender: contender that is evaluated.
        policy: name of the policy in the result.
        weights_sha256: hash of its networks; None for a baseline.
        scenes: name of the scenes, as it was requested.
        seed: seed of scenes and drivers.
        chosen: scenes of the evaluation, in order.
        equivalents: file that lists equivalent code, see `fingerprint.equivalent`.

    Attributes:
        known: episodes in the file by their index in `chosen`, with the same contender and seed, and the same or
            equivalent code.
        stale: number of lines with the same policy, variant and scenes, but with other code, weights or settings.

    Raises:
        RunError: the file has other content, or cannot be written.
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
        code, who = code_sha256(), contender_sha256(contender)
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
        """Return the lines in the file, and remove an incomplete last line, so that the next one is complete."""
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
        """Append one episode to the file."""
        fields_ = asdict(record) | {"poses": [[round(value, 4) for value in pose] for pose in record.poses]}
        line = {**self._about, "index": index, "scene_hash": self._hashes[index], **fields_}
        try:
            with self._file.open("a", encoding="utf-8") as out:
                out.write(json.dumps(line, allow_nan=False) + "\n")
        except OSError as error:
            raise _unwritable(self._file, error) from error


def read(file: Path) -> list[Line]:
    """Return all lines of a file; an incomplete last line is left out.

    Raises:
        RunError: it cannot be read, or has other content.
    """
    return _read(file)[0]


def _read(file: Path) -> tuple[list[Line], int]:
    """Return the complete lines of a file, and the number of bytes that they take."""
    if file.is_dir():
        raise RunError(f"{file} is a folder; allowed is a file that zsdist.evaluate --out FILE.jsonl wrote")
    try:
        content = file.read_bytes()
        size = content.rfind(b"\n") + 1
        texts = content[:size].decode().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RunError(f"episodes cannot be read from {file}: {error}") from error
    rest = content[size:]
    if rest[: len(_BEGINNING)] != _BEGINNING[: len(rest)]:
        raise RunError(f"{file} does not end with an episode of an evaluation; allowed are lines that --out wrote")
    return [_line(text, f"{file}, line {number}") for number, text in enumerate(texts, 1)], size


def _unwritable(file: Path, error: OSError) -> RunError:
    return RunError(f"episodes cannot be written to {file}: {error.strerror or error}")


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is not a number of JSON")


def _line(text: str, place: str) -> Line:
    try:
        fields_read = json.loads(text, parse_constant=_refuse)
        for name in _NATURAL:
            if type(fields_read[name]) is not int or fields_read[name] < 0:
                raise ValueError(f"{name} is {fields_read[name]!r}; allowed is a natural number")
        record = {name: fields_read[name] for name in _RECORD}
        record |= {
            "outcome": Outcome(record["outcome"]),
            "decision_ms": tuple(record["decision_ms"]),
            "poses": tuple(Pose(*map(float, pose)) for pose in record["poses"]),
        }
        return Line({name: fields_read[name] for name in _ABOUT}, EpisodeRecord(**record))
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(
            f"{place} is not an episode of an evaluation ({error}); allowed are lines that --out wrote"
        ) from error
