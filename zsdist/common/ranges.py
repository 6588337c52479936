"""Ranges of settings, as types. They keep sums of rewards, values and potentials finite wherever they are sent."""

from itertools import pairwise
from typing import Annotated

from pydantic import AfterValidator, Field

MAX_CONNECTIONS = 2**25  # between the layers of a network
_FEATURES = 256  # more than a state of either level has


def _sendable(widths: tuple[int, ...]) -> tuple[int, ...]:
    """Return the widths of hidden layers if their weights fit into one message, as do those of a checkpoint."""
    found = sum(above * below for above, below in pairwise((_FEATURES, *widths)))
    if found > MAX_CONNECTIONS:
        raise ValueError(f"the layers have {found} connections; allowed are at most {MAX_CONNECTIONS}")
    return widths


Reward = Annotated[float, Field(ge=-1e6, le=1e6)]
Factor = Annotated[float, Field(gt=0, le=1e6)]
Weight = Annotated[float, Field(ge=0, le=1e6)]
Metres = Annotated[float, Field(ge=0.01, le=1000)]
PhysicsStep = Annotated[float, Field(ge=0.001, le=1)]  # seconds; an action takes about half a second
Steps = Annotated[int, Field(ge=1, le=10_000)]  # of an episode, whose path travels in one record
LearningRate = Annotated[float, Field(gt=0, le=1)]
Ratio = Annotated[float, Field(ge=1e-6, le=1000)]
BatchSize = Annotated[int, Field(ge=1, le=8192)]  # several batches travel in one message
Drives = Annotated[int, Field(ge=1, le=10_000)]  # of a candidate; all those of an actor travel in one message
Window = Annotated[int, Field(ge=1, le=256)]  # frames; an inbox holds no more (`zsdist.protocol.inbox`)
Widths = Annotated[tuple[Annotated[int, Field(ge=1)], ...], AfterValidator(_sendable)]
