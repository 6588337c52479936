"""MCAP files that lose nothing when their writer is killed, and what is left of one that was."""

import struct
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Self

import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from zsdist.common import atomic_files, output_files
from zsdist.common.ownership import Owned
from zsdist.errors import DataError
from zsdist.recording import messages

PROFILE, ENCODING, DEFINITIONS = "ros2", "cdr", "ros2msg"
AT_ONCE = 1  # bytes of a chunk: each message is one, and in the file at once; a chunk of the usual 1 MiB dies with us
# Errors of mcap's readers for a file that is cut, by the place of the cut; their own class does not cover them all.
_UNREADABLE = (McapError, struct.error, zstandard.ZstdError, ValueError)


class Logged(NamedTuple):
    """Message of a file.

    Attributes:
        topic: topic of the message.
        kind: name of its type.
        time_ns: time at which it was logged, nanoseconds.
        content: the message as CDR.
    """

    topic: str
    kind: str
    time_ns: int
    content: bytes

    def decoded(self) -> Any:
        """Return the message."""
        return messages.decode(self.kind, self.content)


class Log(Owned):
    """MCAP file with ROS 2 messages; each is in the file when the call that writes it returns.

    A file whose writer was killed lacks an index. `salvage` makes a whole file of it. Messages of one topic are to be
    written in the order of their times.

    Args:
        path: file to write; an older one is overwritten.
        compressed: whether messages are compressed, each alone; pictures do not get smaller, maps do.
    """

    def __init__(self, path: Path, *, compressed: bool = True) -> None:
        self.path = path
        self._file = path.open("wb")
        compression = CompressionType.ZSTD if compressed else CompressionType.NONE
        self._writer = Writer(self._file, chunk_size=AT_ONCE, compression=compression)
        self._writer.start(PROFILE)
        self._kinds: dict[str, int] = {}  # schema by type
        self._channels: dict[tuple[str, str], int] = {}
        self._file.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def describe(self, name: str, fields: Mapping[str, str]) -> None:
        """Write texts by name that concern the whole file."""
        self._writer.add_metadata(name, dict(fields))
        self._file.flush()

    def write(self, topic: str, message: Any, time_ns: int) -> None:
        """Write a message of `zsdist.recording.messages.types`, or of another store of `rosbags`.

        Args:
            topic: topic of the message.
            message: the message.
            time_ns: time of the message, nanoseconds.
        """
        self.write_encoded(topic, message.__msgtype__, messages.encode(message), time_ns)

    def write_encoded(self, topic: str, kind: str, content: bytes, time_ns: int, sent_ns: int | None = None) -> None:
        """Write a message that is CDR already, as it came from a robot.

        Args:
            topic: topic of the message.
            kind: name of its type, as `nav_msgs/msg/Odometry`.
            content: the message as CDR, with its header of four bytes.
            time_ns: time at which it came, nanoseconds.
            sent_ns: time at which it was sent; None: the same.
        """
        channel = self._channels.get((topic, kind))
        if channel is None:
            if kind not in self._kinds:
                self._kinds[kind] = self._writer.register_schema(kind, DEFINITIONS, messages.definition(kind))
            channel = self._writer.register_channel(topic, ENCODING, self._kinds[kind])
            self._channels[topic, kind] = channel
        self._writer.add_message(channel, time_ns, content, time_ns if sent_ns is None else sent_ns)
        self._file.flush()

    def close(self) -> None:
        """Write the index and close the file; closing again does nothing."""
        if not self._file.closed:
            try:
                self._writer.finish()
            finally:
                self._file.close()


def read(path: Path, topics: Collection[str] | None = None) -> Iterator[Logged]:
    """Yield the messages of a whole file in the order in which they were written.

    Args:
        path: file to read.
        topics: topics to read; None: all. Only these are read from the disk.

    Raises:
        DataError: the file is not a whole MCAP file.
    """
    try:
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages(topics, log_time_order=False):
                yield Logged(channel.topic, "" if schema is None else schema.name, message.log_time, message.data)
    except _UNREADABLE as error:
        raise DataError(f"{path} is not a whole MCAP file ({error or type(error).__name__})") from error


def salvage(path: Path, target: Path) -> int:
    """Write a whole file of all that a killed writer has left in another; return the number of messages.

    Args:
        path: file to read; it is not changed. A whole one is copied.
        target: file to make, in one step.

    Raises:
        DataError: it is not the beginning of an MCAP file.
    """
    partial = target.with_name(f".{target.name}.partial")
    try:
        with output_files.written(str(target)):
            with partial.open("wb") as file:
                count = _copy_records(path, Writer(file))
            atomic_files.sync(partial)
            partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)
    return count


def _copy_records(path: Path, writer: Writer) -> int:
    """Write all whole records of a file into another; return the number of messages."""
    count = 0
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    writer.start(PROFILE)
    for record in _records_left(path):
        if isinstance(record, Schema) and record.id not in schemas:
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel) and record.id not in channels:
            schema, about = schemas[record.schema_id], dict(record.metadata)
            channels[record.id] = writer.register_channel(record.topic, record.message_encoding, schema, about)
        elif isinstance(record, Message):
            times = record.publish_time, record.sequence
            writer.add_message(channels[record.channel_id], record.log_time, record.data, *times)
            count += 1
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, dict(record.metadata))
    writer.finish()
    return count


def _records_left(path: Path) -> Iterator[Any]:
    """Yield the records of a file up to the first that is not whole."""
    with path.open("rb") as file:
        records = StreamReader(file, validate_crcs=True, record_size_limit=path.stat().st_size).records
        began = False
        while True:
            try:
                record = next(records, None)
            except _UNREADABLE as error:
                if not began:
                    raise DataError(f"{path} is not the beginning of an MCAP file") from error
                return
            if record is None:
                return
            began = True
            yield record
