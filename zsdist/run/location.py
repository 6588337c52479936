"""Run directories and checkpoints from the paths that people give: the folder itself, or anything inside it."""

from pathlib import Path

from zsdist.common import folders
from zsdist.errors import RunError

CONFIG_FILE = "config.yaml"
MANIFEST_FILE = "manifest.json"
OF_A_RUN = ("checkpoints", "epochs", "episodes.jsonl")  # beside its configuration, which other folders have too
_DEPTH = 3  # folders between a file of a run and its run directory: checkpoints/00000050/manifest.json


def find_run(path: Path) -> Path:
    """Return the run directory that a path is or lies in; the path itself where it is neither."""
    inside = path.absolute().parents[:_DEPTH]
    if not path.exists() or (path / CONFIG_FILE).is_file():
        return path
    return next((place for place in inside if _is_run(place)), path)


def _is_run(place: Path) -> bool:
    return (place / CONFIG_FILE).is_file() and any((place / name).exists() for name in OF_A_RUN)


def find_checkpoint(path: Path) -> Path | None:
    """Return the checkpoint folder that a path is or lies in; None where it is neither."""
    return next((place for place in (path, path.parent) if (place / MANIFEST_FILE).is_file()), None)


def check_is_newest(path: Path, newest: Path) -> None:
    """Raise `RunError` where a path names a checkpoint that is not the newest of its run, from which a run resumes."""
    asked = find_checkpoint(path)
    if asked is not None and asked.resolve() != newest.resolve():
        raise RunError(
            f"{path} is in checkpoint {asked.resolve().name}, and a run is resumed from its newest, {newest.name}; "
            f"to resume from the older one, move the later ones out of {newest.parent}"
        )


def suggest_run(folder: Path) -> str:
    """Return the end of a message that names what may be meant: a checkpoint, or the newest run in a folder of runs.

    It is empty where there is neither.
    """
    if _is_run(folder.absolute().parent.parent) and folder.parent.name == "checkpoints":
        names = [path.parent.name for path in folders.visible(folder.parent, f"*/{MANIFEST_FILE}")]
        return f"; the checkpoints of that run are {', '.join(sorted(names)) or 'none'}"
    runs = sorted(folders.visible(folder, f"*/{CONFIG_FILE}"), key=lambda file: file.stat().st_mtime)
    return f"; it holds runs, such as {runs[-1].parent}" if runs else ""
