"""Last words of a role that died: what it wrote into its log before its end."""

from pathlib import Path

TAIL_BYTES = 8192
MAX_WORDS = 300  # characters


class RoleLog:
    """Log of one role, `logs/{role}.log` of the run directory, from the start of an incarnation on.

    Args:
        path: path of the log, which need not exist.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._before = self._size()

    def last_words(self) -> str:
        """Return the last line that was written since; empty where nothing was, or the log is elsewhere."""
        size = self._size()
        if size <= self._before:
            return ""
        with self.path.open("rb") as file:
            file.seek(max(self._before, size - TAIL_BYTES))
            lines = file.read().decode(errors="replace").split("\n")
        found = ["".join(filter(str.isprintable, line)).strip() for line in lines]
        return next((line for line in reversed(found) if line), "")[:MAX_WORDS]

    def named_in(self, text: str) -> str:
        """Return a text with the place of the log behind it, where it is on this machine."""
        return f"{text}; its log is {self.path}" if self.path.exists() else text

    def _size(self) -> int:
        return self.path.stat().st_size if self.path.exists() else 0
