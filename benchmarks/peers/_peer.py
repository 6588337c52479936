"""What the peers' scripts share: orders come as lines on standard input, answers go out as JSON lines.

A peer runs in its own environment, so nothing of zsdist is imported here. `insert`, `sample` and `sample_4` (four
batches a message) go on for so many seconds and answer transitions a second; `latency` answers the milliseconds of so
many batches, one after the other.
"""

import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np

BATCH = 256
answers = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(2, 1)  # libraries that print do not answer
COLUMNS = ("state", "action", "reward", "discount", "next_state")


class Peer(Protocol):
    """A replay that is loaded the way its documentation says."""

    def insert(self, seconds: float) -> int:
        """Transitions stored, all of them acknowledged, in so many seconds of offering."""

    def draw(self, batches: int) -> Iterator[int]:
        """Batches without end, so many a message where that can be chosen; yields how many transitions came each time.

        As many are in flight as serves it best.
        """

    def one(self) -> None:
        """One batch of `BATCH`, asked for now and waited for."""


def transitions() -> dict[str, np.ndarray]:
    """The transitions that zsdist's own client pushes, as pairs: columns of `(n,)` or `(n, D)`, trajectories of 8."""
    with np.load(Path(sys.argv[1])) as file:
        return {name: file[name] for name in COLUMNS}


def serve(peer: Peer) -> None:
    """Answers orders until standard input closes."""
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
