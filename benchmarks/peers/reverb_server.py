"""Reverb: server in a process of its own, items written by a trajectory writer, read through a TrajectoryDataset.

States are appended once a step and shared by the two items that use them, as Reverb's documentation advises; both ends
speak gRPC over the loopback. A second, slower way to write, `Client.insert` of whole pairs, is not used.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator

os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"

import numpy as np
from _peer import BATCH, COLUMNS, answers, require, serve, transitions

reverb = require("reverb", "make peers")
tf = require("tensorflow", "make peers")

CAPACITY = 10_000
LENGTH = 8  # number of transitions of a trajectory
ONLY_SERVER = "--server"


def run_server(rows: dict[str, np.ndarray]) -> None:
    """Serve one uniform table and print its port, until standard input closes."""
    item = {name: tf.TensorSpec((1, *rows[name].shape[1:]), rows[name].dtype) for name in COLUMNS}
    table = reverb.Table(
        "replay",
        sampler=reverb.selectors.Uniform(),
        remover=reverb.selectors.Fifo(),
        max_size=CAPACITY,
        rate_limiter=reverb.rate_limiters.MinSize(1),
        signature=item,
    )
    server = reverb.Server([table])
    print(server.port, file=answers)
    sys.stdin.read()
    server.stop()


class Reverb:
    """Client of the server's table."""

    def __init__(self) -> None:
        self._rows = transitions()
        command = [sys.executable, __file__, sys.argv[1], ONLY_SERVER]
        self._server = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._address = f"127.0.0.1:{self._server.stdout.readline().strip()}"
        self._client = reverb.Client(self._address)
        self._batches: Iterator | None = None
        self._next = 0

    def insert(self, seconds: float) -> int:
        """Append steps and create an item for each, until all are in the table."""
        count, until_s = 0, time.perf_counter() + seconds
        with self._client.trajectory_writer(num_keep_alive_refs=2) as writer:
            while time.perf_counter() < until_s:
                count += self._episode(writer)
            writer.flush()
        return count

    def draw(self, batches: int) -> Iterator[int]:
        """Draw batches of the dataset, which its own threads fill."""
        if self._batches is None:
            dataset = reverb.TrajectoryDataset.from_table_signature(
                self._address, "replay", max_in_flight_samples_per_worker=2 * BATCH
            )
            self._batches = iter(dataset.batch(BATCH).prefetch(2))
        for batch in self._batches:
            yield len(batch.data["action"].numpy())

    def one(self) -> None:
        """Take the next batch of the dataset; it may have arrived already, so this is a lower bound of a round trip."""
        next(self.draw(1))

    def _episode(self, writer: "reverb.TrajectoryWriter") -> int:
        rows, start = self._rows, self._next
        self._next = (start + LENGTH) % len(rows["action"])
        for row in range(start, start + LENGTH):
            step = {name: rows[name][row] for name in COLUMNS if name != "next_state"}
            writer.append(step)
            if row > start:
                self._item(writer)
        last = {"state": rows["next_state"][start + LENGTH - 1]}
        writer.append(last, partial_step=False)
        self._item(writer)
        writer.end_episode()
        return LENGTH

    def _item(self, writer: "reverb.TrajectoryWriter") -> None:
        history = writer.history
        item = {name: history[name][-2:-1] for name in COLUMNS if name != "next_state"}
        writer.create_item("replay", 1.0, item | {"next_state": history["state"][-1:]})


if __name__ == "__main__":
    if ONLY_SERVER in sys.argv:
        run_server(transitions())
    else:
        serve(Reverb())
