"""Attachment of every message of rmw_zenoh: sequence number, time and publisher. ROS 2 drops a message without one."""

import struct
from typing import NamedTuple

GID_BYTES = 16
_TODAY = struct.Struct(f"<qqB{GID_BYTES}s")  # 33 bytes
_NAMED = struct.Struct(f"<B15sqB16sqB10sB{GID_BYTES}s")  # rmw_zenoh_cpp before 0.2.3
_NAMES = (b"sequence_number", b"source_timestamp", b"source_gid")


class Attachment(NamedTuple):
    """Content of an attachment.

    Attributes:
        sequence: number of the message, counted by its publisher from 1.
        time_ns: time of publication, nanoseconds since 1970.
        gid: identity of the publisher, 16 bytes.
    """

    sequence: int
    time_ns: int
    gid: bytes

    def pack(self) -> bytes:
        """Return its bytes as today's rmw_zenoh writes them."""
        return _TODAY.pack(self.sequence, self.time_ns, GID_BYTES, self.gid)


def unpack(data: bytes) -> Attachment | None:
    """Return the attachment in bytes of today's or the former layout, which names each field; None if it is none."""
    if len(data) == _TODAY.size:
        sequence, time_ns, size, gid = _TODAY.unpack(data)
        return Attachment(sequence, time_ns, gid) if size == GID_BYTES else None
    if len(data) != _NAMED.size:
        return None
    *first, sequence, second_size, second, time_ns, third_size, third, size, gid = _NAMED.unpack(data)
    sizes, names = (first[0], second_size, third_size), (first[1], second, third)
    if names != _NAMES or sizes != tuple(map(len, _NAMES)) or size != GID_BYTES:
        return None
    return Attachment(sequence, time_ns, gid)
