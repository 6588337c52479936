"""Scenes of a run by number."""

from collections.abc import Callable
from functools import lru_cache

from zsdist.common import random_streams
from zsdist.config import Config
from zsdist.sim.scenes import families, manifest, sources
from zsdist.sim.scenes.scene import Scene

SplitScenes = Callable[[manifest.Split, int], Scene]  # the scene of a split and a number

MERGE_STRIDE = 10_000  # distance between the first validation scenes of two merges; at most so many are driven in one


class SceneSchedule:
    """Scenes by number, a pure function of the seed. Training and validation scenes have different seeds."""

    def __init__(self, config: Config) -> None:
        self._config = config
        stride = config.merge.validation_scenes
        self._sources = [scene_source(name, stride) for name in config.scenes.train]

    def training(self, number: int) -> Scene:
        """Return the scene of training episode `number`: families in turn, one of `train_scenes` scenes of each."""
        source = self._sources[number % len(self._sources)]
        index = int(random_streams.training_scene(self._config.seed, number).integers(self._config.scenes.train_scenes))
        return source("train", index)

    def validation(self, merge: int, index: int) -> Scene:
        """Return validation scene `index` of a merge: the same for all its candidates, new for each merge.

        The number of merges has no limit. Scenes of a family return only after all of its split have been driven.
        """
        source = self._sources[index % len(self._sources)]
        return source("validation", merge * MERGE_STRIDE + index)


def scene_source(name: str, stride: int = 1) -> SplitScenes:
    """Return the function that gives scenes of a family, or of a folder or file of scenes, which serve every split.

    Any number of 0 or more has a scene: a folder begins again after its last file, a family after the last scene of
    the split.

    Args:
        name: family, folder or file.
        stride: number of scenes by which a family is further on when it begins again (`manifest.wrapped`).

    Raises:
        SceneError: `name` is none of these, or the folder has no valid scenes.
    """
    scenes = sources.read_files(name, "scenes.train")
    if scenes is not None:
        return lambda split, number: scenes[number % len(scenes)]

    @lru_cache(maxsize=64)
    def drawn(split: manifest.Split, number: int) -> Scene:
        # The ten scenes of `singleton` are taken by the number itself.
        index = number if name == families.SINGLETON else manifest.wrapped(number, stride)
        return families.draw(name, split, index)

    return drawn
