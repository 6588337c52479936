"""Events of a run for TensorBoard: one file for each start of the run, one record for each row of figures."""

import os
import time
from collections.abc import Mapping
from pathlib import Path

from zsdist.common import folders
from zsdist.common.ownership import Owned

_PATTERN = "events.out.tfevents.*"  # the names that TensorBoard looks for


class Board(Owned):
    """Event file of the present start of a run. Every record is handed to the operating system as it is added."""

    def __init__(self, folder: Path) -> None:
        """Begin a file in `folder`, which is made if missing; its name sorts behind those of earlier starts."""
        # Only the scheduler needs these imports. torch's own writer would import all of torch.
        from tensorboard.compat.proto.event_pb2 import Event
        from tensorboard.summary.writer.record_writer import RecordWriter

        folder.mkdir(parents=True, exist_ok=True)
        seconds, rest = divmod(time.time_ns(), 10**9)
        self._file = (folder / f"{_PATTERN.removesuffix('*')}{seconds:010d}.{rest:09d}").open("xb", buffering=0)
        self._records = RecordWriter(self._file)
        self._described: set[str] = set()  # curves that the file has a description of
        self._records.write(Event(wall_time=time.time(), file_version="brain.Event:2").SerializeToString())

    def add(self, step: int, values: Mapping[str, float]) -> None:
        """Add values at a step of their curves."""
        from tensorboard.compat.proto.event_pb2 import Event
        from tensorboard.compat.proto.tensor_shape_pb2 import TensorShapeProto
        from tensorboard.compat.proto.types_pb2 import DT_FLOAT
        from tensorboard.plugins.scalar.metadata import create_summary_metadata

        event = Event(wall_time=time.time(), step=step)
        for name, value in values.items():
            entry = event.summary.value.add(tag=name)
            entry.tensor.dtype = DT_FLOAT
            entry.tensor.tensor_shape.CopyFrom(TensorShapeProto())
            entry.tensor.float_val.append(value)
            if name not in self._described:
                self._described.add(name)
                entry.metadata.CopyFrom(create_summary_metadata(display_name=None, description=None))
        self._records.write(event.SerializeToString())

    def sync(self) -> None:
        """Return once all events are on the disk."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file; closing again does nothing."""
        self._file.close()


def sizes(folder: Path) -> dict[str, int]:
    """Return the size in bytes of each event file, by name: the point to which `rewind` can go back."""
    return {path.name: path.stat().st_size for path in folders.visible(folder, _PATTERN)}


def rewind(folder: Path, before: Mapping[str, int] | None) -> None:
    """Remove all events that were added after a point in time.

    Args:
        folder: folder of the event files.
        before: what `sizes` returned at that point; None: it is unknown, and all events stay.
    """
    if before is None:
        return
    for path in folders.visible(folder, _PATTERN):
        if path.name not in before:
            path.unlink()
        elif path.stat().st_size > before[path.name]:
            os.truncate(path, before[path.name])
