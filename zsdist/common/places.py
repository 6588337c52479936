"""Texts that are a built-in name or a path. One rule for all: a built-in name is that name, anything else is a path.

So a folder that has a built-in name is `./NAME`, and `find_clash` tells so. A path that is kept is absolute, since a
run may be resumed, and its policy evaluated, from another folder.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import AfterValidator, GetCoreSchemaHandler

FAMILIES = (  # of scenes; `zsdist.sim.scenes.families` makes them
    "singleton",
    "iid",
    "ood-start-goal",
    "ood-layout",
    "ood-clusters",
    "ood-density",
    "ood-appearance",
    "ood-dynamic",
    "ood-all",
    "street",
    "varied",
    "vocabulary",
)
WEIGHTS = "pretrained"  # of vision, in the package
ENCODER = "efficientnet-lite0"


@dataclass(frozen=True)
class Place:
    """Mark of a setting that is a path; pydantic makes its text absolute when it checks the setting.

    Attributes:
        names: built-in names that the setting may have instead of a path.
    """

    names: tuple[str, ...] = ()

    def resolve(self, text: str) -> str:
        """Return a built-in name as it is, and a path as an absolute one; raise `ValueError` for an unknown home."""
        return text if text in self.names else absolute(text)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> Any:
        """Return the schema of the text, followed by `resolve`."""
        return AfterValidator(self.resolve).__get_pydantic_core_schema__(source, handler)


def absolute(text: str) -> str:
    """Return a path as an absolute one, with `~` as the home folder; raise `ValueError` for an unknown user's home."""
    path = expand(text)
    return str(path.resolve() if ".." in path.parts else path.absolute())  # the folder of the call may go


def expand(text: str) -> Path:
    """Return a path with `~` as the home folder; raise `ValueError` for an unknown user's home."""
    try:
        return Path(text).expanduser()
    except RuntimeError as error:  # no such user, or no home
        raise ValueError(f"the home folder of {text.partition('/')[0]!r} is not known") from error


def shown(path: str) -> str:
    """Return a path as a user knows it: by its name alone if it lies in the working directory."""
    return Path(path).name if Path(path).parent == Path.cwd() else path


def find_clash(what: str, name: str, names: Iterable[str]) -> str | None:
    """Return a line for the user where a built-in name is also that of a file or folder here; None where it is not.

    Args:
        what: option or setting that has the name.
        name: text that was given.
        names: built-in names that it may have.
    """
    if name not in names or not Path(name).exists():
        return None
    return f"note: {what} {name!r} is the built-in one; for the one in this folder write ./{name}"
