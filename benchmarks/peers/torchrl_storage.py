"""TorchRL's LazyTensorStorage in this process: no service, nothing between client and storage. A bound, not a rival."""

import time
from collections.abc import Iterator

import torch
from _peer import BATCH, serve, transitions
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

CAPACITY = 10_000
CHUNK = 64  # transitions a call


class TorchRL:
    """The buffer and what is put into it."""

    def __init__(self) -> None:
        torch.set_num_threads(1)
        rows = TensorDict({name: torch.from_numpy(column) for name, column in transitions().items()})
        rows.batch_size = [len(rows["action"])]
        self._chunks = rows.split(CHUNK)
        self._buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(CAPACITY), batch_size=BATCH)

    def insert(self, seconds: float) -> int:
        """Extends the buffer by chunks."""
        count, until_s = 0, time.perf_counter() + seconds
        while time.perf_counter() < until_s:
            chunk = self._chunks[count // CHUNK % len(self._chunks)]
            self._buffer.extend(chunk)
            count += len(chunk)
        return count

    def draw(self, batches: int) -> Iterator[int]:
        """Batches drawn one after the other."""
        while True:
            yield len(self._buffer.sample())

    def one(self) -> None:
        """One batch."""
        self._buffer.sample()


if __name__ == "__main__":
    serve(TorchRL())
