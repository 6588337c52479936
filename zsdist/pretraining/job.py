"""What is to be trained, on what: all that a pretraining needs to be gone on with."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

from zsdist import config as configuration
from zsdist.common import atomic_files
from zsdist.config import Config
from zsdist.errors import ConfigError, RunError
from zsdist.sim.scenes.families import FAMILIES
from zsdist.sim.scenes.manifest import MANIFEST
from zsdist.vision.weights_folder import METADATA_FILE

JOB_FILE = "pretraining.json"
PURPOSE = MANIFEST["vision-training"]
STAGES = ("words", "head", "student")


@dataclass(frozen=True)
class Job:
    """One pretraining.

    Attributes:
        images: pictures to train the head on.
        epochs: passes over them.
        seed: of scenes, places, looks and weights.
        families: of the scenes, of those that are there for the training of vision.
        cityscapes: folder of photographs to train the head on instead; "": rendered pictures.
        stages: of `STAGES`, what is trained.
        config: camera and encoder.
        command: by which it was started.
    """

    images: int
    epochs: int
    seed: int
    families: tuple[str, ...]
    cityscapes: str
    stages: tuple[str, ...]
    config: Config
    command: str

    def to_json(self) -> dict[str, Any]:
        """As `JOB_FILE` holds it."""
        return asdict(self) | {"config": self.config.model_dump(mode="json")}

    @classmethod
    def from_json(cls, tree: dict[str, Any]) -> Self:
        """From what `to_json` gave; raises `ConfigError`, `KeyError` or `TypeError` where it did not."""
        lists = {name: tuple(tree[name]) for name in ("families", "stages")}
        return cls(**{**tree, **lists, "config": configuration.parse(tree["config"])})


def create(folder: Path, job: Job) -> None:
    """Makes the folder of a new pretraining.

    Raises:
        RunError: it holds one, or weights, already; or it cannot be made.
    """
    if (folder / JOB_FILE).exists():
        raise RunError(f"--out {folder} holds a pretraining already; allowed are a new folder, or --resume {folder}")
    if (folder / METADATA_FILE).exists():
        raise RunError(f"--out {folder} holds finished weights; allowed is a new folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        atomic_files.replace(folder / JOB_FILE, json.dumps(job.to_json(), indent=1).encode())
    except OSError as error:
        raise RunError(f"--out {folder} cannot be made: {error.strerror or error}") from error


def reopen(folder: Path) -> Job:
    """The pretraining in a folder; raises `RunError` where there is none to go on with."""
    path = folder / JOB_FILE
    if not path.exists() and (folder / METADATA_FILE).exists():
        raise RunError(f"--resume {folder}: it is finished, and its weights are there")
    try:
        return Job.from_json(json.loads(path.read_text()))
    except OSError as error:
        raise RunError(f"--resume {folder} holds no pretraining: {path} {error.strerror or error}") from error
    except (ConfigError, KeyError, TypeError, ValueError) as error:
        raise RunError(f"--resume {folder}: {path} is damaged: {error}") from error


def check_families(families: tuple[str, ...]) -> None:
    """Raises `ConfigError` unless all are families that vision may be trained on."""
    allowed = ", ".join(PURPOSE.families)
    for family in families:
        if family not in FAMILIES:
            raise ConfigError(f"--families names {family!r}, which is no family; allowed are {allowed}")
        if family not in PURPOSE.families:
            users = [name for name, purpose in MANIFEST.items() if family in purpose.families]
            raise ConfigError(
                f"--families names {family!r}, which is withheld from the training of vision: it is for "
                f"{' and '.join(users)}, whose scenes must be new to it; allowed are {allowed}"
            )


def check_stages(stages: tuple[str, ...]) -> None:
    """Raises `ConfigError` unless all are stages, and the student has its teacher among them."""
    for stage in stages:
        if stage not in STAGES:
            raise ConfigError(f"--stages names {stage!r}; allowed are {', '.join(STAGES)}")
    if "student" in stages and "head" not in stages:
        raise ConfigError("--stages has student without head, from which it learns; allowed is head,student")
