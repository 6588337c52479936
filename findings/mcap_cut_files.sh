#!/bin/sh
# mcap 1.6.0 (Python): a file that was cut off, as a killed writer leaves it, ends the reader for such files with
# `struct.error` in two of three cases, and with the library's own `EndOfFile` in the others.
#
# Input: an MCAP file as `mcap.writer.Writer` writes it, with a chunk for each message, cut after each of its bytes. The
# specification lets a reader recover the records before the cut, and `StreamReader` is the way to do so.
# Behaviour: it yields these records. Then it raises `EndOfFile`, an `McapError`, or `struct.error`, which is none: most
# numbers are unpacked from as many bytes as were left. A program that catches `McapError` loses what it has read
# whenever the writer died at such a byte.
#
# Output seen:
#     EndOfFile: 536 cuts
#     error: 954 cuts
#     all records before the cut were read: True
#
# Ends with status 1 where the behaviour has changed.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mcap==1.6.0
cat > "$folder/cut.py" <<'PYTHON'
import collections
import io
import struct

from mcap.exceptions import McapError
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

file = io.BytesIO()
writer = Writer(file, chunk_size=1)
writer.start("ros2")
schema = writer.register_schema("std_msgs/msg/Bool", "ros2msg", b"bool data")
channel = writer.register_channel("/dead_man", "cdr", schema)
ends = []  # of the file, after each message
for number in range(5):
    writer.add_message(channel, number, b"\0\1\0\0\1", number)
    ends.append(file.tell())
writer.finish()
whole = file.getvalue()

errors, complete = collections.Counter(), True
for at in range(len(whole)):
    found = 0
    try:
        for record in StreamReader(io.BytesIO(whole[:at])).records:
            found += isinstance(record, Message)
    except Exception as error:
        errors[type(error).__name__] += 1
        foreign = not isinstance(error, McapError)
        assert not foreign or isinstance(error, struct.error)
    complete &= found == sum(end <= at for end in ends) or at < ends[-1]
for name, count in sorted(errors.items()):
    print(f"{name}: {count} cuts")
print("all records before the cut were read:", complete)
assert complete and errors["error"] > 0
PYTHON
"$folder/venv/bin/python" "$folder/cut.py"
