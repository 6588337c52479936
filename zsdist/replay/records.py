"""Records of a file that may be damaged: each that is whole is read, whatever is damaged around it.

A record is a header and its content. The header has the file's marker, the record's number, the content's length and
CRC-32, the kind, and a CRC-32 of itself, so the way to the next record is known even where the content is damaged.
Where the header is damaged, the next one is looked for by its marker. The marker of a log is random and known to its
writer alone, so that nothing that others send for storage can pass for a header. The numbers tell how many records are
lost.
"""

import struct
import zlib
from pathlib import Path
from typing import NamedTuple

MARKER_BYTES = 8
_FIELDS = struct.Struct("<8sQIIB")  # marker, number, length and CRC-32 of the content, kind
_CHECK = struct.Struct("<I")  # CRC-32 of the fields
_HEAD_BYTES = _FIELDS.size + _CHECK.size

Record = tuple[int, bytes]  # kind, defined by the writer, and content


class Damage(NamedTuple):
    """Damaged place of a file.

    Attributes:
        path: path of the file.
        at: offset of the place in bytes.
        nbytes: length of the place.
        records: number of records that are lost; at the end of a log, the least number.
    """

    path: Path
    at: int
    nbytes: int
    records: int

    def __str__(self) -> str:
        lost = f"{self.records} of its records are lost" if self.records else "nothing is lost, since a copy is whole"
        return f"{self.path} is damaged: {self.nbytes} bytes from byte {self.at} on; {lost}"


class FoundRecords(NamedTuple):
    """Content of a file.

    Attributes:
        records: whole records, in order.
        end: size of the file without an unfinished record at its end, bytes.
        next_number: number of the next record to be written.
        damage: damaged places, in order.
    """

    records: list[Record]
    end: int
    next_number: int
    damage: list[Damage]


class _Head(NamedTuple):
    number: int
    length: int
    checksum: int
    kind: int


def head(marker: bytes, number: int, kind: int, content: bytes) -> bytes:
    """Return the header of a record.

    Args:
        marker: marker of the file, of `MARKER_BYTES`.
        number: number of records before this one in the file.
        kind: kind of the record, 0 to 255.
        content: content of the record, which follows the header.
    """
    fields = _FIELDS.pack(marker, number, len(content), zlib.crc32(content), kind)
    return fields + _CHECK.pack(zlib.crc32(fields))


def read(content: bytes, marker: bytes, path: Path) -> FoundRecords:
    """Return the whole records in a file's content.

    Bytes at the end that can be the beginning of a record, and no more, are no damage: the writer died there.

    Args:
        content: content of the file.
        marker: marker of its records.
        path: path of the file, for reports.
    """
    records: list[Record] = []
    damage: list[Damage] = []
    at = number = 0
    while at < len(content):
        found = _head_at(content, at, marker)
        if found is not None and found.number >= number:
            body = at + _HEAD_BYTES
            record = content[body : body + found.length]
            if len(record) < found.length and _next_head(content, body, marker, found.number + 1) is None:
                break  # the writer died while it wrote this one
            if len(record) == found.length and zlib.crc32(record) == found.checksum:
                if lost := found.number - number:  # whole blocks are missing before it
                    damage.append(Damage(path, at, 0, lost))
                records.append((found.kind, record))
                at, number = body + found.length, found.number + 1
                continue
        elif len(content) - at < _HEAD_BYTES:
            break  # the writer died while it wrote a header
        after = _next_head(content, at + 1, marker, number)
        place, following = after or (len(content), max(number, found.number if found else 0) + 1)
        damage.append(Damage(path, at, place - at, following - number))
        at, number = place, following
    return FoundRecords(records, at, number, damage)


def _head_at(content: bytes, at: int, marker: bytes) -> _Head | None:
    """Return the header at an offset; None if there is none, or it is damaged."""
    if not content.startswith(marker, at) or len(content) - at < _HEAD_BYTES:
        return None
    (checksum,) = _CHECK.unpack_from(content, at + _FIELDS.size)
    if zlib.crc32(memoryview(content)[at : at + _FIELDS.size]) != checksum:
        return None
    return _Head(*_FIELDS.unpack_from(content, at)[1:])


def _next_head(content: bytes, at: int, marker: bytes, least: int) -> tuple[int, int] | None:
    """Return offset and number of the first whole header from an offset on with this number or a later one."""
    while (at := content.find(marker, at)) >= 0:
        found = _head_at(content, at, marker)
        if found is not None and found.number >= least:
            return at, found.number
        at += 1
    return None
