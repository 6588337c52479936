"""Frame of every message: a header with a checksum, then JSON and named columns, plain or as one zstd frame.

Layout, little-endian:

    magic (4) | version (1) | kind (1) | packing (1) | zero (1) | size of the body (4) | CRC-32 of all other bytes (4)
    body: packing 0: the content; packing 1: one zstd frame of the content that declares its size
    content: size of the JSON (4) | JSON | columns, each padded with zeros to a multiple of 8 bytes

The JSON is `{"meta": ..., "columns": [[name, dtype, shape], ...]}`, padded with spaces so that the columns begin at a
multiple of 8 bytes and can be read in place, without a copy of each.

`unpack` trusts no byte: the only error it raises is `DecodeError`, and it decompresses nothing before it has checked
that the declared size is within the limit.
"""

import json
import math
import struct
import threading
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import zstandard

from zsdist.errors import DecodeError

MAGIC = b"zsdw"
VERSION = 2  # 1: columns unaligned, always compressed
PLAIN, ZSTD = 0, 1  # packings
MAX_COLUMNS = 4096
MAX_DIMENSIONS = 8
MAX_COLUMN_NAME = 200

_HEADER = struct.Struct("<4sBBBBII")
_SIZE = struct.Struct("<I")
_CHECKED = _HEADER.size - _SIZE.size  # bytes of the header that the checksum covers: all before the checksum
_PACKING_AT = 6  # offset of the packing in the header
_ALIGNMENT = 8  # bytes of the largest item of a column
_LARGE = 2**20  # bytes from which a copy takes so long that other threads should run meanwhile
_ZSTD_LEVEL = 1  # level 3 gains under 3.5 % here
_INTEGERS = ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")
_DTYPES = {name: np.dtype(name).newbyteorder("<") for name in ("bool", *_INTEGERS, "float16", "float32", "float64")}
_DTYPE_NAMES = {np.dtype(name): name for name in _DTYPES}  # a dtype's own `name` is slow
_local = threading.local()


def pack(kind: int, meta: dict[str, Any], columns: Mapping[str, np.ndarray], limit: int, packing: int = ZSTD) -> bytes:
    """Return the bytes of a message.

    Args:
        kind: number of the message's type, 0 to 255.
        meta: JSON object.
        columns: arrays by name.
        limit: most bytes that the content may have.
        packing: `PLAIN` or `ZSTD`.

    Raises:
        DecodeError: the receiver would refuse the message: too large, a dtype that is not allowed, or not JSON.
    """
    descriptions = []
    parts: list[bytes | memoryview] = [b""]
    for name, column in columns.items():
        dtype = _DTYPE_NAMES.get(column.dtype)
        if dtype is None:
            raise DecodeError("dtype", f"column {name!r} is {column.dtype}")
        descriptions.append([name, dtype, list(column.shape)])
        parts += (np.ascontiguousarray(column, dtype=_DTYPES[dtype]).data, bytes(-column.nbytes % _ALIGNMENT))
    require_json(meta)
    text = json.dumps({"meta": meta, "columns": descriptions}, separators=(",", ":")).encode()
    text += b" " * (-(_SIZE.size + len(text)) % _ALIGNMENT)
    parts[0] = _SIZE.pack(len(text)) + text
    size = sum(len(part) if isinstance(part, bytes) else part.nbytes for part in parts)
    if size > limit:
        raise DecodeError("size", f"{size} bytes; allowed are at most {limit}")
    if packing == ZSTD:
        return seal(kind, _compressor().compress(_joined(parts, size)))
    header = _header(kind, size, PLAIN, VERSION)
    checksum = zlib.crc32(header)
    for part in parts:
        checksum = zlib.crc32(part, checksum)
    return b"".join((header, _SIZE.pack(checksum), *parts))  # the only copy


def seal(kind: int, body: bytes, packing: int = ZSTD, *, version: int = VERSION) -> bytes:
    """Return a message with header and checksum for a body that is already packed."""
    header = _header(kind, len(body), packing, version)
    return b"".join((header, _SIZE.pack(zlib.crc32(body, zlib.crc32(header))), body))


def _joined(parts: Sequence[bytes | memoryview], size: int) -> bytes | memoryview:
    """Return parts as one buffer; large ones are copied by numpy, which lets other threads run meanwhile."""
    if size < _LARGE:
        return b"".join(parts)
    joined, end = np.empty(size, np.uint8), 0
    for part in parts:
        if count := part.nbytes if isinstance(part, memoryview) else len(part):
            joined[end : end + count] = np.frombuffer(part, np.uint8)
            end += count
    return joined.data


def _header(kind: int, size: int, packing: int, version: int) -> bytes:
    """Return the part of a header that the checksum covers."""
    return _HEADER.pack(MAGIC, version, kind, packing, 0, size, 0)[:_CHECKED]


def read_kind(payload: bytes) -> int:
    """Return the number of a message's type; raise `DecodeError` if its header or checksum is wrong."""
    if len(payload) < _HEADER.size:
        raise DecodeError("short", f"{len(payload)} bytes")
    magic, version, kind, packing, zero, size, checksum = _HEADER.unpack_from(payload)
    if magic != MAGIC:
        raise DecodeError("magic")
    if version != VERSION:
        raise DecodeError("version", f"{version}; allowed is {VERSION}")
    if size != len(payload) - _HEADER.size:
        raise DecodeError("length", f"{len(payload) - _HEADER.size} bytes where {size} were declared")
    view = memoryview(payload)
    if zlib.crc32(view[_HEADER.size :], zlib.crc32(view[:_CHECKED])) != checksum:
        raise DecodeError("checksum")
    if zero or packing not in (PLAIN, ZSTD):
        raise DecodeError("header")
    return int(kind)


def unpack(payload: bytes, limit: int) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the meta object and the columns of a message whose header `read_kind` has checked.

    Args:
        payload: the whole message.
        limit: most bytes of the content after decompression.

    Returns:
        The meta object, and the columns by name. They are parts of one buffer that belongs to the caller.

    Raises:
        DecodeError: the body is not valid.
    """
    body = memoryview(payload)[_HEADER.size :]
    content = _inflate(body, limit) if payload[_PACKING_AT] == ZSTD else _copied(body, limit)
    if len(content) < _SIZE.size:
        raise DecodeError("content")
    (size,) = _SIZE.unpack_from(content)
    start = _SIZE.size + size
    if start > len(content):
        raise DecodeError("content")
    meta, descriptions = _parse_json(bytes(content[_SIZE.size : start]))
    if start % _ALIGNMENT:
        raise DecodeError("alignment", f"columns begin at byte {start}")
    columns: dict[str, np.ndarray] = {}
    for item in descriptions:
        name, dtype, shape = _read_description(item)
        if name in columns:
            raise DecodeError("column", f"{name!r} twice")
        count = math.prod(shape)
        end = start + count * dtype.itemsize
        padded = end + -end % _ALIGNMENT
        if padded > len(content):
            raise DecodeError("shape", f"column {name!r} is longer than the message")
        if padded != end and any(content[end:padded]):
            raise DecodeError("padding", f"after column {name!r}")
        if dtype == np.bool_ and np.frombuffer(content, np.uint8, count, start).max(initial=0) > 1:
            raise DecodeError("boolean", f"column {name!r}")
        column = np.frombuffer(content, dtype, count, start).reshape(shape)
        columns[name] = column if dtype.isnative else column.astype(dtype.newbyteorder("="))
        start = padded
    if start != len(content):
        raise DecodeError("trailing", f"{len(content) - start} bytes")
    return meta, columns


def require_json(value: object) -> None:
    """Raise `DecodeError` unless JSON preserves `value` exactly: string keys, finite numbers, no tuples."""
    if value is None or isinstance(value, bool | str):
        return
    if isinstance(value, int):
        if abs(value) >= 2**127:  # enough for the state of a random generator; more digits are an attack
            raise DecodeError("json", "an integer of more than 127 bits")
    elif isinstance(value, float):
        if not math.isfinite(value):
            raise DecodeError("json", f"{value} is not a JSON number")
    elif isinstance(value, list):
        for item in value:
            require_json(item)
    elif isinstance(value, dict):
        for key, item in value.items():
            if not isinstance(key, str):
                raise DecodeError("json", f"key {key!r} is not a string")
            require_json(item)
    else:
        raise DecodeError("json", f"a {type(value).__name__} is not a JSON value")


def _copied(body: memoryview, limit: int) -> memoryview:
    """Return a copy of content that was sent uncompressed."""
    if len(body) > limit:
        raise DecodeError("size", f"{len(body)} bytes; allowed are at most {limit}")
    return _writable(body)


def _writable(content: bytes | memoryview) -> memoryview:
    """Return a copy that may be written to; a large one is made by numpy, which lets other threads run meanwhile."""
    if len(content) < _LARGE:
        return memoryview(bytearray(content))
    return np.array(np.frombuffer(content, np.uint8)).data


def _inflate(frame: memoryview, limit: int) -> memoryview:
    """Return the content of exactly one zstd frame.

    The size is checked first, since the library ignores an output limit for a frame that declares its size.
    """
    try:
        declared = zstandard.get_frame_parameters(frame).content_size
        if declared in (zstandard.CONTENTSIZE_UNKNOWN, zstandard.CONTENTSIZE_ERROR):
            raise DecodeError("size", "no declared content size")
        if declared > limit:
            raise DecodeError("size", f"{declared} bytes declared; allowed are at most {limit}")
        content = _decompressor().decompress(frame, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise DecodeError("zstd", str(error)) from error
    if len(content) != declared:
        raise DecodeError("zstd", "the content does not have the declared size")
    return _writable(content)


def _parse_json(text: bytes) -> tuple[dict[str, Any], list[Any]]:
    """Return the checked meta object, and the list that describes the columns, still unchecked."""

    def refuse(word: str) -> None:
        raise DecodeError("json", f"{word} is not a JSON number")

    try:
        tree = json.loads(text.decode(), parse_constant=refuse)
        if not isinstance(tree, dict) or set(tree) != {"meta", "columns"}:
            raise DecodeError("meta")
        meta, descriptions = tree["meta"], tree["columns"]
        if not isinstance(meta, dict) or not isinstance(descriptions, list) or len(descriptions) > MAX_COLUMNS:
            raise DecodeError("meta")
        require_json(meta)
    except (ValueError, RecursionError) as error:
        raise DecodeError("json", str(error)) from error
    return meta, descriptions


def _read_description(item: object) -> tuple[str, np.dtype, tuple[int, ...]]:
    """Return name, dtype and shape of a column."""
    if not isinstance(item, list) or len(item) != 3:
        raise DecodeError("column")
    name, dtype, shape = item
    if not isinstance(name, str) or not 0 < len(name) <= MAX_COLUMN_NAME:
        raise DecodeError("column")
    if not isinstance(dtype, str) or dtype not in _DTYPES:
        raise DecodeError("dtype", f"column {name!r} is {dtype!r}"[:80])
    if not isinstance(shape, list) or len(shape) > MAX_DIMENSIONS:
        raise DecodeError("shape", f"column {name!r}")
    for size in shape:
        if type(size) is not int or not 0 <= size < 2**32:
            raise DecodeError("shape", f"column {name!r}")
    return name, _DTYPES[dtype], tuple(shape)


def _compressor() -> zstandard.ZstdCompressor:
    """Return the compressor of this thread: it is costly to make and may not be shared between threads."""
    if not hasattr(_local, "compressor"):
        _local.compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL, write_content_size=True)
    compressor: zstandard.ZstdCompressor = _local.compressor
    return compressor


def _decompressor() -> zstandard.ZstdDecompressor:
    """Return the decompressor of this thread."""
    if not hasattr(_local, "decompressor"):
        _local.decompressor = zstandard.ZstdDecompressor()
    decompressor: zstandard.ZstdDecompressor = _local.decompressor
    return decompressor
