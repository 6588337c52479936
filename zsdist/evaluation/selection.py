"""Selection of an evaluation's scenes from a folder, a family, or a split of the configuration."""

from zsdist.config import Config
from zsdist.planning.grid import Grid
from zsdist.sim.scenes import families, sources
from zsdist.sim.scenes.manifest import Split
from zsdist.sim.scenes.scene import Scene

DEFAULT_EPISODES = 50
SEED_STRIDE = 1000  # seeds of evaluations are this many scenes apart
SPLIT_SIZE = 1_000_000
SPLITS: tuple[Split, ...] = ("train", "validation", "test")
BUILT_IN = (*SPLITS, *families.FAMILIES)


def select(name: str, config: Config, episodes: int | None, seed: int) -> list[Scene]:
    """Return the scenes of an evaluation, in the order in which they are reported.

    Args:
        name: family, whose test scenes are taken; or split of the configuration: `train` or `validation` (from
            `scenes.train`), or `test` (from `scenes.test`), with its families in turn; or folder or file of scenes.
        config: configuration with the families of the splits, and the grid that scene files must fit.
        episodes: number of scenes; None: all files of a folder, else 50. A folder with fewer files is repeated.
        seed: seed that selects the scenes of a family, the same for every policy; a folder gives its files in order.
            `train` has only the `scenes.train_scenes` scenes that training draws from, so seeds may share some.

    Raises:
        SceneError: the name is none of these, or a scene file is wrong.
    """
    grid = Grid.from_config(config.grid)
    split = next((split for split in SPLITS if split == name), None)
    if split is not None:
        families_of_split = config.scenes.test if split == "test" else config.scenes.train
        setting = f"scenes.{'test' if split == 'test' else 'train'}"
        files = {source: sources.read_files(source, setting, grid=grid) for source in families_of_split}
        drawn = []
        for index in range(episodes or DEFAULT_EPISODES):
            source, turn = families_of_split[index % len(families_of_split)], index // len(families_of_split)
            scenes = files[source]
            drawn.append(scenes[turn % len(scenes)] if scenes else _draw(source, split, turn, seed, config))
        return drawn
    scenes = sources.read_files(name, "--scenes", SPLITS, grid=grid)
    if scenes is None:
        return [_draw(name, "test", index, seed, config) for index in range(episodes or DEFAULT_EPISODES)]
    return [scenes[index % len(scenes)] for index in range(episodes or len(scenes))]


def _draw(family: str, split: Split, index: int, seed: int, config: Config) -> Scene:
    if split == "train":  # the scenes that training draws from, and no others
        return families.draw(family, split, (seed * DEFAULT_EPISODES + index) % config.scenes.train_scenes)
    return families.draw(family, split, (seed * SEED_STRIDE + index) % SPLIT_SIZE)
