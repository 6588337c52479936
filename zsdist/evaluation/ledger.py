"""Episodes on file, one JSON line each, with the hashes of what they depend on: measured once, not driven again."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from zsdist.errors import RunError
from zsdist.evaluation.entrants import Entrant
from zsdist.evaluation.identity import code_sha256, entrant_sha256
from zsdist.evaluation.records import EpisodeRecord
from zsdist.sim.scene import Scene
from zsdist.types import Outcome, Pose

_RECORD = {item.name for item in fields(EpisodeRecord)}
_ABOUT = ("code", "entrant", "policy", "variant", "weights_sha256", "shielded", "scenes", "seed", "index", "scene_hash")


@dataclass(frozen=True)
class Line:
    """One line of the file: an episode's `record`, and `about` it the hashes and what was asked for."""

    about: Mapping[str, Any]
    record: EpisodeRecord


class Ledger:
    """The episodes of one evaluation in a file that may hold those of others.

    Args:
        file: is made where it is not there.
        entrant: who drives.
        policy: what the result calls it.
        weights_sha256: of its networks.
        scenes: what was asked for.
        seed: of scenes and drivers.
        chosen: the scenes themselves.

    Attributes:
        known: episodes on file, by their place among the chosen scenes, measured with the same code, entrant and seed.
        stale: lines of the same policy, variant and scenes that are not: of other code, weights or settings.

    Raises:
        RunError: the file holds something else, or cannot be written.
    """

    def __init__(
        self,
        file: Path,
        entrant: Entrant,
        policy: str,
        weights_sha256: str | None,
        scenes: str,
        seed: int,
        chosen: list[Scene],
    ) -> None:
        self._file = file
        asked = {
            "policy": policy,
            "variant": entrant.variant,
            "shielded": entrant.shielded,
            "scenes": scenes,
            "seed": seed,
        }
        code, who = code_sha256(), entrant_sha256(entrant)
        self._about = {"code": code, "entrant": who, **asked, "weights_sha256": weights_sha256}
        self._hashes = [scene.hash() for scene in chosen]
        self.known: dict[int, EpisodeRecord] = {}
        self.stale = 0
        for line in read(file) if file.exists() else ():
            about, index = line.about, line.about["index"]
            same = (about["code"], about["entrant"], about["seed"]) == (code, who, seed)
            if same and index < len(chosen) and about["scene_hash"] == self._hashes[index]:
                self.known[index] = line.record
            elif not same and all(about[key] == value for key, value in asked.items()):
                self.stale += 1

    def add(self, index: int, record: EpisodeRecord) -> None:
        """Writes one episode to the file."""
        fields_ = asdict(record) | {"poses": [[round(value, 4) for value in pose] for pose in record.poses]}
        line = {**self._about, "index": index, "scene_hash": self._hashes[index], **fields_}
        try:
            with self._file.open("a") as out:
                out.write(json.dumps(line, allow_nan=False) + "\n")
        except OSError as error:
            raise RunError(f"episodes cannot be written to {self._file}: {error.strerror or error}") from error


def read(file: Path) -> list[Line]:
    """All lines of a file; a last line that was cut off as it was written is taken out of it.

    Raises:
        RunError: it cannot be read, or holds something else.
    """
    try:
        content = file.read_text()
        if content and not content.endswith("\n"):
            content = content[: content.rfind("\n") + 1]
            file.write_text(content)
    except (OSError, UnicodeDecodeError) as error:
        raise RunError(f"episodes cannot be read from {file}: {error}") from error
    return [_line(text, f"{file}, line {number}") for number, text in enumerate(content.splitlines(), 1)]


def _line(text: str, place: str) -> Line:
    try:
        told = json.loads(text)
        record = {name: told[name] for name in _RECORD}
        record |= {
            "outcome": Outcome(record["outcome"]),
            "decision_ms": tuple(record["decision_ms"]),
            "poses": tuple(Pose(*pose) for pose in record["poses"]),
        }
        return Line({name: told[name] for name in _ABOUT}, EpisodeRecord(**record))
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(
            f"{place} is no episode of an evaluation ({error}); allowed are lines that --out wrote"
        ) from error
