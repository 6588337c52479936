"""Settings of a pretraining, kept in its folder so that it can be resumed."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

from zsdist import config as configuration
from zsdist.common import atomic_files, commands
from zsdist.config import Config
from zsdist.errors import ConfigError, RunError
from zsdist.sim.scenes.families import FAMILIES
from zsdist.sim.scenes.manifest import MANIFEST
from zsdist.vision.weights_folder import METADATA_FILE

JOB_FILE = "pretraining.json"
PURPOSE = MANIFEST["vision-training"]
STAGES = ("words", "head", "student", "compact")


@dataclass(frozen=True)
class Job:
    """Settings of one pretraining.

    Attributes:
        images: number of pictures to train the head on; the compact network gets as many at most in an epoch.
        epochs: number of passes over the pictures in every stage; 0: the default of each stage.
        seed: seed of scenes, poses, appearance and weights.
        families: scene families, from those for the training of vision.
        cityscapes: folder of photographs to train the head on; "": rendered pictures.
        stages: stages to train, from `STAGES`.
        config: configuration with the camera and the encoder.
        command: command line that started the pretraining.
    """

    images: int
    epochs: int
    seed: int
    families: tuple[str, ...]
    cityscapes: str
    stages: tuple[str, ...]
    config: Config
    command: str

    def shard_seed(self, name: str) -> int:
        """Return the seed of the pictures of a shard."""
        return int.from_bytes(hashlib.sha256(f"{self.seed} {name}".encode()).digest()[:7])

    def to_json(self) -> dict[str, Any]:
        """Return the content of `JOB_FILE`."""
        return asdict(self) | {"config": self.config.model_dump(mode="json")}

    @classmethod
    def from_json(cls, tree: dict[str, Any]) -> Self:
        """Return the job that `to_json` described; raise `ConfigError`, `KeyError` or `TypeError` if it is damaged."""
        lists = {name: tuple(tree[name]) for name in ("families", "stages")}
        if tree["cityscapes"] and not Path(tree["cityscapes"]).is_absolute():
            raise ConfigError(
                f"cityscapes is {tree['cityscapes']!r}, a relative path that an earlier version kept; "
                "write the folder of the photographs there"
            )
        return cls(**{**tree, **lists, "config": configuration.parse(tree["config"])})


def create(folder: Path, job: Job, lock: Callable[[Path], None] = lambda folder: None) -> None:
    """Create the folder of a new pretraining.

    Args:
        folder: folder to make.
        job: settings that are kept in it.
        lock: called with the folder once it exists, before anything is written to it.

    Raises:
        RunError: the folder already holds a pretraining or weights, or cannot be created.
    """
    _check_new(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock(folder)
        _check_new(folder)  # again: another process may have been faster
        atomic_files.replace(folder / JOB_FILE, json.dumps(job.to_json(), indent=1).encode())
    except OSError as error:
        raise RunError(f"--out {folder} cannot be made: {error.strerror or error}") from error


def _check_new(folder: Path) -> None:
    if (folder / JOB_FILE).exists():
        again = commands.quoted("--resume", folder.absolute())
        raise RunError(f"--out {folder} already holds a pretraining; allowed are a new folder, or {again}")
    if (folder / METADATA_FILE).exists():
        raise RunError(f"--out {folder} holds finished weights; allowed is a new folder")


def reopen(folder: Path) -> Job:
    """Return the pretraining in a folder; raise `RunError` if there is none that can be resumed."""
    path = folder / JOB_FILE
    if not path.exists() and (folder / METADATA_FILE).exists():
        raise RunError(f"--resume {folder}: the pretraining is finished; its weights are in this folder")
    try:
        return Job.from_json(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise RunError(f"--resume {folder} holds no pretraining: {path} {error.strerror or error}") from error
    except ConfigError as error:
        raise RunError(f"--resume {folder}: {path}: {error}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise RunError(f"--resume {folder}: {path} is damaged: {error}") from error


def check_families(families: tuple[str, ...]) -> None:
    """Raise `ConfigError` unless vision may be trained on all families."""
    allowed = ", ".join(PURPOSE.families)
    for family in families:
        if family not in FAMILIES:
            raise ConfigError(f"--families names {family!r}, which is not a scene family; allowed are {allowed}")
        if family not in PURPOSE.families:
            users = [name for name, purpose in MANIFEST.items() if family in purpose.families]
            raise ConfigError(
                f"--families names {family!r}, which is withheld from the training of vision, since its scenes must be "
                f"new in {' and '.join(users)}; allowed are {allowed}"
            )


def check_stages(stages: tuple[str, ...]) -> None:
    """Raise `ConfigError` unless all stages exist, and the student comes with the head, its teacher."""
    for stage in stages:
        if stage not in STAGES:
            raise ConfigError(f"--stages names {stage!r}; allowed are {', '.join(STAGES)}")
    if "student" in stages and "head" not in stages:
        raise ConfigError("--stages has student without head, its teacher; allowed is head,student")
