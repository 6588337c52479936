"""Configurations that come with the package, by name. A preset's name is always the preset; anything else is a path."""

from pathlib import Path

from zsdist.common import folders, places

FOLDER = Path(__file__).parents[1] / "presets"
COMPARED = "baselines"  # folder in it, with trained comparisons


def names() -> list[str]:
    """Return the names of all presets, those of trained comparisons last."""
    return [path.stem for path in _files()]


def find(text: str) -> Path | None:
    """Return the file of the preset with a name; None where there is none."""
    return next((path for path in _files() if path.stem == text), None)


def find_clash(text: str) -> str | None:
    """Return a line for the user where a preset's name is also that of a file or folder here; None where it is not."""
    return places.find_clash("configuration", text, names())


def _files() -> list[Path]:
    return [*folders.visible(FOLDER, "*.yaml"), *folders.visible(FOLDER / COMPARED, "*.yaml")]
