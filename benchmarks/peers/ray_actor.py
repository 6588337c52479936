"""Ray actor that holds a numpy ring; 16 calls in flight and 64 transitions an insert were the fastest here."""

import os
import time
from collections import deque
from collections.abc import Iterator

import numpy as np
from _peer import BATCH, require, serve, transitions

ray = require("ray", "pip install ray")

CAPACITY = 10_000
IN_FLIGHT = 16
CHUNK = 64  # number of transitions a call


class Ring:
    """Ring of transitions in the actor's process."""

    def __init__(self, columns: dict[str, np.ndarray]) -> None:
        self._columns = {name: np.empty((CAPACITY, *rows.shape[1:]), rows.dtype) for name, rows in columns.items()}
        self._size = self._head = 0
        self._rng = np.random.default_rng(0)

    def insert(self, columns: dict[str, np.ndarray]) -> int:
        """Store rows in place of the oldest ones; return their number."""
        count = len(columns["action"])
        places = (self._head + np.arange(count)) % CAPACITY
        for name, rows in columns.items():
            self._columns[name][places] = rows
        self._head, self._size = (self._head + count) % CAPACITY, min(self._size + count, CAPACITY)
        return count

    def sample(self, count: int) -> dict[str, np.ndarray]:
        """Draw rows uniformly."""
        places = self._rng.integers(0, self._size, count)
        return {name: rows.take(places, axis=0) for name, rows in self._columns.items()}


class RayActor:
    """Client of the ring."""

    def __init__(self) -> None:
        ray.init(
            address="local",
            num_cpus=2,
            include_dashboard=False,
            log_to_driver=False,
            logging_level="ERROR",
            object_store_memory=512 * 2**20,
            _node_ip_address="127.0.0.1",
        )
        rows = transitions()
        self._chunks = [
            {name: column[start : start + CHUNK] for name, column in rows.items()}
            for start in range(0, len(rows["action"]), CHUNK)
        ]
        self._ring = ray.remote(Ring).remote(rows)

    def insert(self, seconds: float) -> int:
        """Insert for `seconds` with `IN_FLIGHT` calls in flight; return the number of stored transitions."""
        flight: deque = deque()
        count, number, until_s = 0, 0, time.perf_counter() + seconds
        while time.perf_counter() < until_s:
            flight.append(self._ring.insert.remote(self._chunks[number % len(self._chunks)]))
            number += 1
            if len(flight) >= IN_FLIGHT:
                count += ray.get(flight.popleft())
        return count + sum(ray.get(list(flight)))

    def draw(self, batches: int) -> Iterator[int]:
        """Draw batches with `IN_FLIGHT` of them in flight; yield the transitions of each message."""
        flight = deque(self._ring.sample.remote(batches * BATCH) for _ in range(IN_FLIGHT // batches))
        while True:
            drawn = ray.get(flight.popleft())
            flight.append(self._ring.sample.remote(batches * BATCH))
            yield len(drawn["action"])

    def one(self) -> None:
        """Draw one batch and wait for it."""
        ray.get(self._ring.sample.remote(BATCH))


if __name__ == "__main__":
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    serve(RayActor())
