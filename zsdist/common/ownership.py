"""Objects that belong to one process, since they hold an open file, a connection or a thread."""

import os
from typing import Any, NoReturn, Self, SupportsIndex


class Owned:
    """Base of objects that can be neither copied nor pickled, nor used in a process forked from theirs."""

    _process: int

    def __new__(cls, *_: Any, **__: Any) -> Self:
        """Make the object, and remember its process."""
        made = super().__new__(cls)
        made._process = os.getpid()
        return made

    def __reduce_ex__(self, protocol: SupportsIndex) -> NoReturn:
        raise TypeError(
            f"a {type(self).__name__} can be neither copied nor pickled, since it holds an open file or connection; "
            "make another one"
        )

    @property
    def is_foreign(self) -> bool:
        """True in a process forked from the one that made the object."""
        return os.getpid() != self._process

    def check_process(self) -> None:
        """Raise `RuntimeError` in a process forked from the one that made the object."""
        if self.is_foreign:
            raise RuntimeError(
                f"this {type(self).__name__} belongs to process {self._process}; a process forked from it needs its own"
            )
