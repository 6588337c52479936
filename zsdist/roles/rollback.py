"""Return of a learner to its last sound state after an update that went wrong, and the file that shows the update."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

import numpy as np

from zsdist.common import atomic_files, commands, finite, folders
from zsdist.config import Config, parse
from zsdist.dqn.base import BaseDqnLearner
from zsdist.dqn.soundness import UnsoundUpdateError
from zsdist.errors import ConfigError, DecodeError, RunError
from zsdist.roles import divergence
from zsdist.types import Batch, Level
from zsdist.wire import codec
from zsdist.wire.messages import State

FILES_KEPT = 4  # of all levels; the newest
ALLOWED = 3  # rollbacks in a row, before the run ends
FORGIVEN_AFTER = 10_000  # sound updates after which earlier rollbacks no longer count as in a row
KEPT_EVERY = 250  # updates from one kept state to the next


class Rollbacks:
    """Last sound state of a learner, the rule how often it may return there, and the files of refused updates.

    The state is a copy in memory, made anew every `KEPT_EVERY` sound updates.

    Args:
        dqn: learner, which is sound now.
        config: configuration of the run.
        level: level of the learner.
        folder: folder of the files, made when the first is written; None: none are written.

    Attributes:
        count: number of rollbacks.
    """

    def __init__(self, dqn: BaseDqnLearner, config: Config, level: Level, folder: Path | None) -> None:
        self._dqn, self._config, self._level, self._folder = dqn, config, level, folder
        self.count = 0
        self._in_a_row = 0
        self._sound_updates = 0  # since the last rollback
        self._kept = dqn.state()

    def note_update(self) -> str | None:
        """Count a sound update, and keep the state where it is time; return what is wrong with a state that is not."""
        self._sound_updates += 1
        if self._sound_updates >= FORGIVEN_AFTER:
            self._in_a_row = 0
        if self._sound_updates % KEPT_EVERY:
            return None
        state = self._dqn.state()
        found = not_finite("state", state)
        if found is None:
            self._kept = state
        return found

    def go_back(self, found: str, updates: int, episodes: int) -> None:
        """Restore the last sound state.

        Args:
            found: what was found.
            updates: number of updates so far.
            episodes: number of finished episodes of the run.

        Raises:
            RunError: it has been restored `ALLOWED` times in a row.
        """
        if self._in_a_row >= ALLOWED:
            told = f"{found}; it went back to a sound state {ALLOWED} times before"
            raise divergence.diverged(self._config, self._level, updates, episodes, told)
        self._dqn.restore(self._kept)
        self.count += 1
        self._in_a_row += 1
        self._sound_updates = 0

    def explain(self, error: UnsoundUpdateError, batch: Batch, updates: int) -> str:
        """Return what was wrong in a refused update and where first, and write it with the state and its batch.

        Args:
            error: error that the update raised; the learner has not changed since.
            batch: its batch.
            updates: number of updates before.
        """
        found, first = divergence.beyond(error.largest, self._dqn.limit), self._dqn.examine(batch)
        if first is not None:
            found += f", first in {first}"
        if self._folder is None:
            return found
        file = self._folder / f"{self._level}-{updates + 1:08d}-{self.count + 1}.state"
        try:
            self._write(file, batch, updates)
        except OSError as failure:
            return f"{found} (the update cannot be written to {file}: {failure.strerror})"
        return f"{found}; make the update again with {commands.module('zsdist.doctor', '--replay-update', file)}"

    def _write(self, file: Path, batch: Batch, updates: int) -> None:
        arrays = {f"dqn/{key}": array for key, array in self._dqn.state().items()}
        columns = {field.name: getattr(batch, field.name) for field in fields(batch)}
        arrays |= {f"batch/{key}": np.asarray(column) for key, column in columns.items() if column is not None}
        meta = {"level": self._level.value, "updates": updates, "config": self._config.model_dump(mode="json")}
        file.parent.mkdir(parents=True, exist_ok=True)
        atomic_files.replace(file, codec.encode(State(f"learner-{self._level}", meta, arrays)))
        for old in sorted(folders.visible(file.parent, "*.state"), key=_age)[:-FILES_KEPT]:
            old.unlink(missing_ok=True)


class RefusedUpdate(NamedTuple):
    """Update that was refused.

    Attributes:
        config: configuration of the run.
        level: level of the learner.
        number: number of the update, from 1.
        dqn: the learner before the update.
        batch: batch of the update.
    """

    config: Config
    level: Level
    number: int
    dqn: BaseDqnLearner
    batch: Batch


def read_update(file: Path, make_learner: Callable[[Config, Level], BaseDqnLearner]) -> RefusedUpdate:
    """Return the update in a file of a run's folder `nan`.

    Args:
        file: the file.
        make_learner: function that makes the learner of a level.

    Raises:
        RunError: the file cannot be read, or holds no update.
    """
    try:
        state = codec.decode(file.read_bytes(), expect=State)
        config, level, updates = parse(state.meta["config"]), Level(state.meta["level"]), int(state.meta["updates"])
        dqn, batch = make_learner(config, level), Batch(**state.part("batch/"))
        dqn.restore(state.part("dqn/"), check=False)
    except OSError as error:
        raise RunError(f"update {file} cannot be read: {error.strerror}") from error
    except (DecodeError, ConfigError, RunError, KeyError, TypeError, ValueError) as error:
        raise RunError(f"update {file} holds no update of a learner: {error}") from error
    dqn.limit = divergence.value_limit(config, level)
    return RefusedUpdate(config, level, updates + 1, dqn, batch)


def not_finite(what: str, arrays: Mapping[str, np.ndarray]) -> str | None:
    """Return which array of a network or a state holds a number that is not finite; None: none does."""
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not finite.all_finite(array):
            return f"its {what} holds a number that is not finite, in {name}"
    return None


def _age(file: Path) -> tuple[int, str]:
    return file.stat().st_mtime_ns, file.name
