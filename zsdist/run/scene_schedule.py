"""Scenes of a run by number."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

from zsdist.common import random_streams
from zsdist.config import Config
from zsdist.errors import SceneError
from zsdist.sim.scenes import families, scene
from zsdist.sim.scenes.scene import Scene

SplitScenes = Callable[[str, int], Scene]  # the scene of a split ("train", "validation") and an index


class SceneSchedule:
    """Scenes by number, a pure function of the seed. Training and validation scenes have different seeds."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._sources = [scene_source(name) for name in config.scenes.train]

    def training(self, number: int) -> Scene:
        """Return the scene of training episode `number`: families in turn, one of `train_scenes` scenes of each."""
        source = self._sources[number % len(self._sources)]
        index = int(random_streams.training_scene(self._config.seed, number).integers(self._config.scenes.train_scenes))
        return source("train", index)

    def validation(self, merge: int, index: int) -> Scene:
        """Return validation scene `index` of a merge: the same for all its candidates, new for each merge."""
        source = self._sources[index % len(self._sources)]
        return source("validation", merge * 10_000 + index)


def scene_source(name: str) -> SplitScenes:
    """Return the function that gives scenes of a family, or of a folder of scene files, which serve every split.

    Raises:
        SceneError: `name` is neither, or the folder has no valid scenes.
    """
    if name in families.FAMILIES:
        return lru_cache(maxsize=64)(lambda split, index: families.draw(name, split, index))
    if not Path(name).is_dir():
        allowed = ", ".join(families.FAMILIES)
        raise SceneError(f"source of scenes {name!r} is no folder; allowed are {allowed} and a folder of scene files")
    scenes = scene.read_folder(Path(name))
    return lambda split, index: scenes[index % len(scenes)]
