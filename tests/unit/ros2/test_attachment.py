import struct

import pytest
from zenoh import ext

from zsdist.ros2.attachment import Attachment, unpack

GID = bytes(range(16))


def test_the_attachment_is_what_the_serializer_of_zenoh_writes():
    written = ext.z_serialize((ext.Int64(5), ext.Int64(1_700_000_000_000_000_000), GID)).to_bytes()
    packed = Attachment(5, 1_700_000_000_000_000_000, GID).pack()
    assert packed == written and len(packed) == 33


def test_both_layouts_are_read():
    attachment = Attachment(5, -3, GID)
    names = [b"sequence_number", b"source_timestamp", b"source_gid"]
    former = b"".join(
        bytes([len(name)]) + name + value
        for name, value in zip(names, [struct.pack("<q", 5), struct.pack("<q", -3), b"\x10" + GID], strict=True)
    )
    assert unpack(attachment.pack()) == unpack(former) == attachment


@pytest.mark.parametrize("data", [b"", bytes(33), bytes(77), Attachment(1, 2, GID).pack() + b"x"])
def test_what_is_no_attachment_gives_none(data):
    assert unpack(data) is None
