"""Functions of the peers' scripts: commands are lines on standard input, answers are JSON lines on standard output.

A peer runs in its own environment, so nothing of zsdist is imported here. `insert`, `sample` and `sample_4` (four
batches a message) run for the given seconds and answer with transitions a second. `latency` answers with the
milliseconds of the given number of batches, one after the other.
"""

import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))
from _common import require as require

BATCH = 256
answers = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(2, 1)  # output of libraries must not mix with answers
COLUMNS = ("state", "action", "reward", "discount", "next_state")


class Peer(Protocol):
    """Client of a replay, used as its documentation recommends."""

    def insert(self, seconds: float) -> int:
        """Offer transitions for `seconds`; return the number that was stored and acknowledged."""

    def draw(self, batches: int) -> Iterator[int]:
        """Draw batches endlessly, `batches` in a message if the peer allows it; yield the transitions of each message.

        The number of messages in flight is the best one for the peer.
        """

    def one(self) -> None:
        """Request one batch of `BATCH` and wait for it."""


def transitions() -> dict[str, np.ndarray]:
    """Return the transitions that zsdist's client pushes, as columns `(n,)` or `(n, D)`, from trajectories of 8."""
    with np.load(Path(sys.argv[1])) as file:
        return {name: file[name] for name in COLUMNS}


def serve(peer: Peer) -> None:
    """Answer commands until standard input closes."""
    print(json.dumps("ready"), file=answers)
    for line in sys.stdin:
        what, amount = line.split()
        began_s = time.perf_counter()
        if what == "insert":
            count = peer.insert(float(amount))
            answer: object = count / (time.perf_counter() - began_s)
        elif what in ("sample", "sample_4"):
            count = 0
            for taken in peer.draw(4 if what == "sample_4" else 1):
                count += taken
                if time.perf_counter() - began_s >= float(amount):
                    break
            answer = count / (time.perf_counter() - began_s)
        else:
            answer = []
            for _ in range(int(amount)):
                began_s = time.perf_counter()
                peer.one()
                answer.append(1000 * (time.perf_counter() - began_s))
        print(json.dumps(answer), file=answers)
