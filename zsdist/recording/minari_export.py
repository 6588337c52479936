"""Export of recorded episodes as a Minari data set, which is whole after each episode.

Minari's own writer changes a set in place, and one that is killed meanwhile leaves it unreadable. So each episode is
written as a set of its own in a hidden folder; then it is moved into place, and the list of episodes is replaced in one
step.
"""

import json
import shutil
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from zsdist.common import atomic_files, folders
from zsdist.errors import RunError
from zsdist.planning.grid import Grid
from zsdist.recording.episode import RecordedEpisode
from zsdist.types import Action

ENVIRONMENT = "zsdist/CarNavigation-v0"
FORMAT = "parquet"  # compresses pictures without loss; Minari's other formats do not, or need jax
_DATA = "data"  # folder in which Minari looks for a set
_METADATA = "metadata.json"
_BYTES_PER_MB = 1_000_000


def require_minari() -> ModuleType:
    """Return the package `minari` with what `FORMAT` needs; raise `RunError` where it is not installed."""
    try:
        import_module("pyarrow.dataset")
        return import_module("minari")
    except ImportError as error:
        raise RunError(
            f"--format minari needs the package {error.name}, which is not installed; "
            "install it with pip install 'zsdist[datasets]', or record with --format mcap"
        ) from error


class MinariSet:
    """Minari data set that grows by one episode at a time.

    Args:
        root: folder that is given to Minari as `MINARI_DATASETS_PATH`.
        name: name of the set, as `zsdist/pretrained-v0`.
        grid: planning grid, whose arena bounds poses and goals.
        config: settings of the environment, as plain data.
        about: further fields of the set's metadata, such as `description`.

    Raises:
        RunError: Minari is not installed.
    """

    def __init__(self, root: Path, name: str, grid: Grid, config: dict[str, Any], about: dict[str, Any]) -> None:
        self._minari = require_minari()
        self._name, self._grid, self._config, self._about = name, grid, config, about
        self._data = root / name / _DATA
        self._staging = self._data.with_name(f".{_DATA}.partial")
        file = self._data / _METADATA
        self._metadata: dict[str, Any] = {"total_episodes": 0, "total_steps": 0, "dataset_size": 0.0}
        if file.is_file():
            self._metadata = json.loads(file.read_text(encoding="utf-8"))

    @property
    def path(self) -> Path:
        """Folder of the set, which `minari.MinariDataset` takes."""
        return self._data

    @property
    def episodes(self) -> int:
        """Number of episodes that it holds."""
        return int(self._metadata["total_episodes"])

    def append(self, episode: RecordedEpisode) -> None:
        """Add an episode; the set is whole before and after, whatever happens in between."""
        from minari.data_collector import EpisodeBuffer
        from minari.dataset.minari_storage import MinariStorage

        number = self.episodes
        shutil.rmtree(self._staging, ignore_errors=True)
        self._staging.mkdir(parents=True)
        self._data.mkdir(exist_ok=True)
        storage = MinariStorage.new(
            self._staging,
            observation_space=self._observations(episode),
            action_space=spaces.Discrete(len(Action)),
            env_spec=self._environment(),
            data_format=FORMAT,
            jpeg_encoding=False,  # else pictures become JPEG, which loses bits
        )
        goals = np.tile(np.array(episode.goal), (len(episode.poses), 1))
        buffer = EpisodeBuffer(
            id=number,
            options={"scene": episode.result["scene"], "outcome": episode.result["outcome"]},
            observations={"image": episode.pictures, "pose": episode.poses, "goal": goals},
            actions=episode.actions,
            rewards=episode.rewards.sum(axis=1),
            terminations=episode.terminated,
            truncations=episode.truncated,
        )
        storage.update_episodes([buffer])
        place = self._data / str(number)
        shutil.rmtree(place, ignore_errors=True)  # of a writer that was killed before it counted the episode
        (self._staging / str(number)).replace(place)
        metadata = json.loads((self._staging / _METADATA).read_text(encoding="utf-8"))
        metadata |= {
            "dataset_id": self._name,
            "minari_version": self._minari.__version__,
            **self._about,
            "total_episodes": number + 1,
            "total_steps": self._metadata["total_steps"] + len(episode.actions),
            "dataset_size": round(self._metadata["dataset_size"] + _megabytes(place), 3),
        }
        for path in folders.visible(place):
            atomic_files.sync(path)
        atomic_files.replace(self._data / _METADATA, json.dumps(metadata).encode())
        self._metadata = metadata
        shutil.rmtree(self._staging)

    def _observations(self, episode: RecordedEpisode) -> spaces.Dict:
        """Return the observation space of the environment."""
        wall = self._grid.arena_m / 2
        farthest = np.array([wall, wall, np.pi])
        return spaces.Dict(
            {
                "image": spaces.Box(0, 255, episode.pictures.shape[1:], np.uint8),
                "pose": spaces.Box(-farthest, farthest, dtype=np.float64),
                "goal": spaces.Box(-wall, wall, (2,), np.float64),
            }
        )

    def _environment(self) -> EnvSpec | None:
        """Return the specification from which Minari makes the environment again; None where it is not registered."""
        spec = gymnasium.registry.get(ENVIRONMENT)
        return None if spec is None else EnvSpec(ENVIRONMENT, spec.entry_point, kwargs={"config": self._config})


def _megabytes(folder: Path) -> float:
    return sum(path.stat().st_size for path in folders.visible(folder)) / _BYTES_PER_MB


def set_name(words: Sequence[str]) -> str:
    """Return the name of a set made of words that describe it, in the characters that Minari allows."""
    kept = ("".join(letter if letter.isalnum() else "-" for letter in word).strip("-") for word in words)
    return f"zsdist/{'-'.join(word for word in kept if word)}-v0"
