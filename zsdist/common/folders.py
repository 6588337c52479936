"""Listing of folders in which a file manager, an editor, an archive or a killed process may have left files of its own.

Such files have hidden names: `.DS_Store`, `._name` from an archive made on a Mac, `.nfs0000` of a network file system,
`.#name` of an editor, and our own `.name.partial`. No other module lists a folder.
"""

from pathlib import Path


def visible(folder: Path, pattern: str = "*") -> list[Path]:
    """Return the paths under a folder that match a glob pattern, in order, without those with a hidden part.

    Args:
        folder: folder, which may be hidden itself; one that does not exist has nothing in it.
        pattern: pattern of names relative to the folder, in which `**` stands for any number of folders.
    """
    found = (path for path in folder.glob(pattern) if path != folder)
    return sorted(path for path in found if not any(part.startswith(".") for part in path.relative_to(folder).parts))


def numbered(folder: Path) -> list[Path]:
    """Return the entries of a folder whose names are numbers, in order of the numbers, whatever their width."""
    return sorted((path for path in visible(folder) if is_number(path.name)), key=lambda path: int(path.name))


def is_number(text: str) -> bool:
    """Return whether a text consists of digits alone."""
    return text.isascii() and text.isdecimal()
