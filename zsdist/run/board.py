"""Events of a run for TensorBoard: one file for each start of the run, one record for each row of figures.

Curves are in groups, `group/name`: `outcomes`, `run`, `actors`, `high`, `low`, `replay_high`, `replay_low`, `episode`.
What a run has learned and drawn at its end is in groups of its own, see `zsdist.reporting.results_board`.
"""

import os
import struct
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zsdist.common import commands, folders, setting_trees
from zsdist.common.ownership import Owned

if TYPE_CHECKING:
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.compat.proto.summary_pb2 import SummaryMetadata

_PATTERN = "events.out.tfevents.*"  # the names that TensorBoard looks for
_GROUPS = ("replay_high", "replay_low", "high", "low", "actors")  # beginnings of figures' names
_OUTCOMES = frozenset(
    ("success", "collision", "timeout", "recent_success", "recent_collision", "mean_return", "average_reward")
)
_PNG_SIZE = slice(16, 24)  # width and height in the head of a PNG file


def tag(figure: str) -> str:
    """Return the group and the name of a figure of `metrics.jsonl`, such as `low/loss` for `low_loss`."""
    if figure in _OUTCOMES:
        return f"outcomes/{figure}"
    if figure == "env_steps_per_s":
        return f"actors/{figure}"
    group = next((group for group in _GROUPS if figure.startswith(f"{group}_")), None)
    return f"run/{figure}" if group is None else f"{group}/{figure.removeprefix(f'{group}_')}"


def command(folder: Path) -> str:
    """Return the command that shows the run in `folder`."""
    return commands.quoted(commands.python(), "-m", "tensorboard.main", "--logdir", folder.absolute())


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
        from tensorboard.compat.proto.tensor_shape_pb2 import TensorShapeProto
        from tensorboard.compat.proto.types_pb2 import DT_FLOAT
        from tensorboard.plugins.scalar.metadata import create_summary_metadata

        event = _event(step)
        for name, value in values.items():
            entry = event.summary.value.add(tag=name)
            entry.tensor.dtype = DT_FLOAT
            entry.tensor.tensor_shape.CopyFrom(TensorShapeProto())
            entry.tensor.float_val.append(value)
            if name not in self._described:
                self._described.add(name)
                entry.metadata.CopyFrom(create_summary_metadata(display_name=None, description=None))
        self._records.write(event.SerializeToString())

    def add_settings(self, text: str, tree: Mapping[str, Any]) -> None:
        """Add the configuration of the run, as a text and as the values by which TensorBoard compares runs.

        Args:
            text: content of `config.yaml`.
            tree: the settings in it.
        """
        from tensorboard.plugins.hparams import metadata, plugin_data_pb2

        self.add_text("configuration", f"```yaml\n{text}\n```")
        info = plugin_data_pb2.SessionStartInfo(start_time_secs=time.time())
        for name, value in setting_trees.flat(tree).items():
            if isinstance(value, bool):
                info.hparams[name].bool_value = value
            elif isinstance(value, int | float):
                info.hparams[name].number_value = value
            elif value is not None:
                info.hparams[name].string_value = str(value)
        data = plugin_data_pb2.HParamsPluginData(session_start_info=info)
        null = metadata.NULL_TENSOR
        event = _event(0)
        entry = event.summary.value.add(tag=metadata.SESSION_START_INFO_TAG, tensor=null)
        entry.metadata.CopyFrom(metadata.create_summary_metadata(data))
        self._records.write(event.SerializeToString())

    def add_text(self, name: str, markdown: str, step: int = 0) -> None:
        """Add a text."""
        from tensorboard.plugins.text import metadata

        described = metadata.create_summary_metadata(display_name=None, description=None)
        self._add_strings(name, step, [markdown.encode()], described)

    def add_picture(self, name: str, png: bytes, step: int = 0) -> None:
        """Add a picture, the content of a PNG file."""
        from tensorboard.plugins.image import metadata

        described = metadata.create_summary_metadata(display_name=None, description=None)
        width, height = struct.unpack(">II", png[_PNG_SIZE])
        self._add_strings(name, step, [str(width).encode(), str(height).encode(), png], described, shape=(3,))

    def _add_strings(
        self, name: str, step: int, strings: list[bytes], described: "SummaryMetadata", shape: tuple[int, ...] = ()
    ) -> None:
        from tensorboard.compat.proto.tensor_shape_pb2 import TensorShapeProto
        from tensorboard.compat.proto.types_pb2 import DT_STRING

        event = _event(step)
        entry = event.summary.value.add(tag=name, metadata=described)
        entry.tensor.dtype = DT_STRING
        entry.tensor.tensor_shape.CopyFrom(TensorShapeProto(dim=[TensorShapeProto.Dim(size=size) for size in shape]))
        entry.tensor.string_val.extend(strings)
        self._records.write(event.SerializeToString())

    def sync(self) -> None:
        """Return once all events are on the disk."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file; closing again does nothing."""
        self._file.close()


def _event(step: int) -> "Event":
    from tensorboard.compat.proto.event_pb2 import Event

    return Event(wall_time=time.time(), step=step)


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
