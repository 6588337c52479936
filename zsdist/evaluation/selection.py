"""Selection of an evaluation's scenes from a folder, a family, or a split of the configuration."""

from pathlib import Path

from zsdist.config import Config
from zsdist.errors import SceneError
from zsdist.planning.grid import Grid
from zsdist.sim.scenes import families, scene
from zsdist.sim.scenes.manifest import Split
from zsdist.sim.scenes.scene import Scene

DEFAULT_EPISODES = 50
SEED_STRIDE = 1000  # seeds of evaluations are this many scenes apart
SPLIT_SIZE = 1_000_000
SPLITS: tuple[Split, ...] = ("train", "validation", "test")


def select(name: str, config: Config, episodes: int | None, seed: int) -> list[Scene]:
    """Return the scenes of an evaluation, in the order in which they are reported.

    Args:
        name: family, whose test scenes are taken; or split of the configuration: `train` or `validation` (from
            `scenes.train`), or `test` (from `scenes.test`), with its families in turn; or folder of scene files.
        config: configuration with the families of the splits, and the grid that scene files must fit.
        episodes: number of scenes; None: all files of a folder, else 50. A folder with fewer files is repeated.
        seed: seed that selects the scenes of a family, the same for every policy; a folder gives its files in order.

    Raises:
        SceneError: the name is none of these, or a scene file is wrong.
    """
    if name in families.FAMILIES:
        return [_draw(name, "test", index, seed) for index in range(episodes or DEFAULT_EPISODES)]
    split = next((split for split in SPLITS if split == name), None)
    if split is not None:
        sources = config.scenes.test if split == "test" else config.scenes.train
        grid, drawn = Grid.from_config(config.grid), []
        folders = {source: scene.read_folder(source, grid) for source in sources if source not in families.FAMILIES}
        for index in range(episodes or DEFAULT_EPISODES):
            source = sources[index % len(sources)]
            turn = index // len(sources)
            files = folders.get(source)
            drawn.append(files[turn % len(files)] if files else _draw(source, split, turn, seed))
        return drawn
    if Path(name).is_dir():
        files = scene.read_folder(name, Grid.from_config(config.grid))
        return [files[index % len(files)] for index in range(episodes or len(files))]
    allowed = ", ".join((*SPLITS, *families.FAMILIES))
    raise SceneError(f"scenes is {name!r}; allowed are {allowed} and a folder of scene files")


def _draw(family: str, split: Split, index: int, seed: int) -> Scene:
    return families.draw(family, split, (seed * SEED_STRIDE + index) % SPLIT_SIZE)
