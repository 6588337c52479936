"""Learner of a distributed run, which goes on where its predecessor was."""

import time
from pathlib import Path

from zsdist.dqn.base import BaseDqnLearner
from zsdist.roles.base import Context
from zsdist.roles.kept_state import KeptState
from zsdist.roles.learner import Learner
from zsdist.run import checkpoint_states
from zsdist.types import Level
from zsdist.wire.messages import State


def resumed(
    context: Context, level: Level, dqn: BaseDqnLearner, restored: State | None, *, folder: Path, start: str
) -> Learner:
    """Return a learner with the newest state that there is: kept by a predecessor, else in a checkpoint, else `dqn`.

    Args:
        context: identity of the role.
        level: level that it learns.
        dqn: networks and optimiser as a new run begins with them.
        restored: state from which this start of the run was resumed; None: it is a new run.
        folder: run directory; where it does not exist, on another machine, nothing is kept.
        start: word for this start of the run.
    """
    if not folder.is_dir():
        return Learner(context, level, dqn, restored)
    kept = KeptState(folder / "journal" / f"{start}-{context.name}", context.epoch)
    state, published = kept.recover()
    if state is None:
        saved = [found for found in (checkpoint_states.newest(folder, context.name), restored) if found is not None]
        state = max(saved, key=lambda found: found.meta["updates"], default=None)
    learner = Learner(context, level, dqn, state, kept, folder / "nan")
    learner.continue_after(published)
    if kept.damaged:
        files, now = " ".join(kept.damaged)[:200], time.time()
        learner.event(now, "kept_state_damaged", level=level.value, files=files, goes_on_at_update=learner.updates)
    return learner
