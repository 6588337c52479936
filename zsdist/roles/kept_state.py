"""State of a learner on the disk, from which the successor of a learner that died goes on.

Each incarnation writes files of its own, so that one that was replaced and wakes up again changes nothing that its
successor reads. They are handed to the operating system and not forced onto the disk: they survive the death of the
process, which is all that a successor on the same machine needs.
"""

import contextlib
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, Self

from zsdist.common import atomic_files, folders
from zsdist.errors import DecodeError, RunError
from zsdist.roles.schemas import CandidateName
from zsdist.types import Parameters
from zsdist.wire import codec
from zsdist.wire.frame import PLAIN
from zsdist.wire.messages import State

KEEP_EVERY_S = 2.0
SHARE = 0.02  # part of its time that a learner spends on keeping its state
KEEP_AFTER_S = 30.0  # longest time between two states, whatever it costs
DIGITS = 20  # of the epoch in names of files, so that they sort by it


class MergeState(NamedTuple):
    """Part of a kept state that no checkpoint has: a run that is resumed from one begins its merge anew.

    Attributes:
        offered: index of the last merge for which candidates were made.
        candidates: those that may still be chosen, by name.
        paused: whether the learner has stopped learning for now.
    """

    offered: int
    candidates: dict[CandidateName, Parameters]
    paused: bool

    @classmethod
    def of(cls, state: State) -> Self | None:
        """Return the part of a kept state; None for a state from a checkpoint."""
        if "offered" not in state.meta:
            return None
        candidates = {name: state.part(f"candidates/{name}/") for name in state.meta["candidates"]}
        return cls(state.meta["offered"], candidates, state.meta["paused"])

    def added_to(self, state: State) -> State:
        """Return a state with this part added."""
        arrays = {
            f"candidates/{name}/{key}": array
            for name, parameters in self.candidates.items()
            for key, array in parameters.items()
        }
        added = {"offered": self.offered, "candidates": list(self.candidates), "paused": self.paused}
        return State(state.role, state.meta | added, state.arrays | arrays)


class KeptState:
    """Newest state of one incarnation of a learner, and those that its predecessors left.

    Args:
        folder: folder of the files, shared with the predecessors in this start of the run; created if missing.
        epoch: epoch of this incarnation.
        clock: function that returns the time in seconds by which the cost of writing is measured.

    Attributes:
        damaged: names of files that were found damaged.

    Raises:
        RunError: the folder cannot be created.
    """

    def __init__(self, folder: Path, epoch: int, clock: Callable[[], float] = time.perf_counter) -> None:
        self.damaged: list[str] = []
        self._folder, self._clock = folder, clock
        self._state, self._version = (folder / f"{epoch:0{DIGITS}d}.{kind}" for kind in ("state", "version"))
        self._next_s = 0.0
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise self._failed("created", error) from error

    def recover(self) -> tuple[State | None, int]:
        """Return the newest state that a predecessor left, and the newest version of weights that one published.

        A damaged file is passed over and listed in `damaged`. Without a state there is None; without a version, 0.

        Raises:
            RunError: a file cannot be read.
        """
        state = None
        try:
            for path in reversed(self._of_predecessors("state")):
                try:
                    state = codec.decode(path.read_bytes(), expect=State)
                    break
                except DecodeError:
                    self.damaged.append(path.name)
            versions = [path.read_text(encoding="utf-8") for path in self._of_predecessors("version")]
        except OSError as error:
            raise self._failed("read", error) from error
        published = [int(text) for text in versions if text.isdecimal()]
        known = [state.meta["version"]] if state is not None else []
        return state, max([*published, *known], default=0)

    def is_due(self, now: float) -> bool:
        """Return whether the state should be kept again, if it has changed."""
        return now >= self._next_s

    def keep(self, make_state: Callable[[], State], now: float) -> None:
        """Replace the kept state, and remove what the predecessors left.

        Args:
            make_state: function that returns the state.
            now: current time, seconds.

        Raises:
            RunError: the disk is full, or the folder cannot be written.
        """
        started_s = self._clock()
        try:
            atomic_files.replace(self._state, codec.encode(make_state(), packing=PLAIN), sync=False)
            for path in self._of_predecessors("state"):
                path.unlink(missing_ok=True)
        except OSError as error:
            raise self._failed("written", error) from error
        self._next_s = now + min(max(KEEP_EVERY_S, (self._clock() - started_s) / SHARE), KEEP_AFTER_S)

    def note_version(self, version: int) -> None:
        """Write down the version of weights that are about to be published, so that no successor publishes it again.

        Raises:
            RunError: the disk is full, or the folder cannot be written.
        """
        try:
            atomic_files.replace(self._version, str(version).encode(), sync=False)
        except OSError as error:
            raise self._failed("written", error) from error

    def discard(self) -> None:
        """Remove all files: the last checkpoint holds everything."""
        with contextlib.suppress(OSError):
            shutil.rmtree(self._folder)

    def _of_predecessors(self, kind: str) -> list[Path]:
        """Return the files of older incarnations, oldest first."""
        return [path for path in sorted(folders.visible(self._folder, f"*.{kind}")) if path.name < self._state.name]

    def _failed(self, done: str, error: OSError) -> RunError:
        return RunError(f"kept state {self._folder} cannot be {done}: {error.strerror or error}")
