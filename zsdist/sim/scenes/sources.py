"""Sources of scenes by name: a family, or a folder or file of scenes. A family's name is always the family."""

from collections.abc import Iterable

from zsdist.common import places
from zsdist.errors import SceneError
from zsdist.planning.grid import Grid
from zsdist.sim.scenes import families, scene
from zsdist.sim.scenes.scene import Scene


def read_files(
    name: str, what: str = "source of scenes", names: Iterable[str] = (), grid: Grid = scene.DEFAULT_GRID
) -> list[Scene] | None:
    """Return the scenes of a folder of scene files, or of one file; None where the name is that of a family.

    Args:
        name: name of a family, or path.
        what: option or setting that has the name, for the error.
        names: further allowed names, for the error.
        grid: grid that the scenes must fit.

    Raises:
        SceneError: the name is neither, or a scene file is wrong.
    """
    if name in families.FAMILIES:
        return None
    try:
        path = places.expand(name)
    except ValueError as error:
        raise SceneError(f"{what} {name!r}: {error}") from error
    if path.is_dir():
        return scene.read_folder(path, grid)
    if path.is_file():
        return [scene.read(path, grid)]
    allowed = ", ".join((*names, *families.FAMILIES))
    files = "a folder of scene files, or one file"
    raise SceneError(f"{what} {places.shown(name)!r} is no folder; allowed are {allowed} and {files}")
