"""TorchRL's LazyTensorStorage in this process: without a service in between, so it is a bound, not a competitor."""

import time
from collections.abc import Iterator

from _peer import BATCH, require, serve, transitions

torch = require("torch", "make peers")
tensordict = require("tensordict", "make peers")
data = require("torchrl.data", "make peers")

CAPACITY = 10_000
CHUNK = 64  # number of transitions a call


class TorchRL:
    """Replay buffer in this process, and the transitions to insert."""

    def __init__(self) -> None:
        torch.set_num_threads(1)
        rows = tensordict.TensorDict({name: torch.from_numpy(column) for name, column in transitions().items()})
        rows.batch_size = [len(rows["action"])]
        self._chunks = rows.split(CHUNK)
        self._buffer = data.TensorDictReplayBuffer(storage=data.LazyTensorStorage(CAPACITY), batch_size=BATCH)

    def insert(self, seconds: float) -> int:
        """Extend the buffer by chunks."""
        count, until_s = 0, time.perf_counter() + seconds
        while time.perf_counter() < until_s:
            chunk = self._chunks[count // CHUNK % len(self._chunks)]
            self._buffer.extend(chunk)
            count += len(chunk)
        return count

    def draw(self, batches: int) -> Iterator[int]:
        """Draw batches one after the other."""
        while True:
            yield len(self._buffer.sample())

    def one(self) -> None:
        """Draw one batch."""
        self._buffer.sample()


if __name__ == "__main__":
    serve(TorchRL())
