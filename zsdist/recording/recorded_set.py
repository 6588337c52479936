"""Sets of recorded episodes: a folder with a manifest and one MCAP file an episode, each of them complete or absent."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from zsdist.common import atomic_files, folders, output_files
from zsdist.config import CameraConfig, Config
from zsdist.errors import DataError, DecodeError
from zsdist.recording import log, messages
from zsdist.recording.contract import TransitionContract
from zsdist.types import Level, Trajectories
from zsdist.wire import codec
from zsdist.wire.messages import Push

MANIFEST = "set.json"
ABOUT = "zsdist"  # name of the metadata of each file: the manifest of its set, and its scene
_EPISODE = re.compile(r"episode-(\d{6})\.mcap")


class SetManifest(BaseModel):
    """Description of a recorded set.

    Attributes:
        format: version of this description.
        zsdist: version of the package that recorded it.
        policy: policy that drove, as it was named.
        variant: variant of a learned policy; empty for a baseline.
        weights_sha256: hash of its networks; None for a baseline.
        scenes: split, family or folder of its scenes.
        seed: seed that selected the scenes.
        pictures: form of the pictures; `png` keeps every bit, `jpeg` does not.
        camera: the camera.
        transitions: contract of the transitions; None: the policy has no two levels, and none were recorded.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    format: Literal[1] = 1
    zsdist: str
    policy: str
    variant: str
    weights_sha256: str | None
    scenes: str
    seed: int
    pictures: Literal["jpeg", "png"]
    camera: CameraConfig
    transitions: TransitionContract | None


def write_manifest(folder: Path, manifest: SetManifest) -> None:
    """Write the manifest of a set into its folder, in one step."""
    with output_files.written(f"recorded set {folder}"):
        atomic_files.replace(folder / MANIFEST, (manifest.model_dump_json(indent=1) + "\n").encode())


def episode_path(folder: Path, number: int) -> Path:
    """Return the file of an episode of a set."""
    return folder / f"episode-{number:06d}.mcap"


class RecordedSet:
    """Recorded set in a folder.

    Args:
        folder: folder of the set.

    Attributes:
        manifest: description of the set.

    Raises:
        DataError: there is no set, or its manifest is damaged or of another version.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            content = (folder / MANIFEST).read_text(encoding="utf-8")
            self.manifest = SetManifest.model_validate_json(content)
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise DataError(
                f"{folder} is not a recorded set ({MANIFEST}: {reason}); allowed is a folder made by zsdist record"
            ) from error
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"]))
            raise DataError(
                f"{folder / MANIFEST} is damaged or of another version ({where or 'content'}: {first['msg']}); "
                "allowed is what this version of zsdist record writes"
            ) from error

    def episodes(self) -> dict[int, Path]:
        """Return the files of the finished episodes by number, in order."""
        found = ((_EPISODE.fullmatch(path.name), path) for path in folders.visible(self.folder, "episode-*.mcap"))
        return {int(match[1]): path for match, path in sorted(found, key=lambda one: one[1]) if match}

    def check(self, config: Config) -> None:
        """Check that a run can learn from the transitions of the set.

        Args:
            config: configuration of the run.

        Raises:
            DataError: it holds none, or they were made under another grid, action table, features or rewards.
        """
        what = f"recorded set {self.folder}"
        if self.manifest.transitions is None:
            raise DataError(
                f"{what} holds no transitions, since {self.manifest.policy!r} does not decide on two levels; "
                "allowed are sets of a learned policy or of a baseline on a believed map, such as astar-vision"
            )
        if not self.episodes():
            raise DataError(f"{what} holds 0 finished episodes; allowed is 1 or more")
        self.manifest.transitions.check(what, config)

    def trajectories(self, level: Level) -> Iterator[Trajectories]:
        """Yield the transitions of a level in the order in which they were made, in small parts.

        Raises:
            DataError: a file is damaged.
        """
        for path in self.episodes().values():
            for logged in log.read(path, (messages.TRANSITIONS,)):
                message = logged.decoded()
                if message.level == level:
                    try:
                        push = codec.decode(message.frame.tobytes(), expect=Push)
                    except DecodeError as error:
                        raise DataError(f"{path} holds transitions that cannot be read ({error}); remove it") from error
                    assert isinstance(push.trajectories, Trajectories), "decoded frames hold joined trajectories"
                    yield push.trajectories


def describe_file(manifest: SetManifest, number: int, scene: Any) -> dict[str, str]:
    """Return the metadata of an episode's file.

    Args:
        manifest: manifest of its set.
        number: number of the episode in the set.
        scene: text of the scene file.
    """
    return {"manifest": manifest.model_dump_json(), "episode": str(number), "scene": str(scene)}
