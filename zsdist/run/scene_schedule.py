"""Scenes of a run by number."""

from collections.abc import Callable
from functools import lru_cache

from zsdist.common import random_streams
from zsdist.config import Config
from zsdist.sim.scenes import families, sources
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
    """Return the function that gives scenes of a family, or of a folder or file of scenes, which serve every split.

    Raises:
        SceneError: `name` is neither, or the folder has no valid scenes.
    """
    scenes = sources.read_files(name)
    if scenes is None:
        return lru_cache(maxsize=64)(lambda split, index: families.draw(name, split, index))
    return lambda split, index: scenes[index % len(scenes)]
