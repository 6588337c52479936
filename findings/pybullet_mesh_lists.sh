#!/bin/sh
# PyBullet 3.2.7: the lists given to createVisualShape(GEOM_MESH, vertices=..., normals=...) are kept for ever.
#
# Input: three visual meshes of 4,608 vertices each, made in one client, followed by resetSimulation, 15 times.
# Behaviour: the process grows with every round, although resetSimulation removes the shapes: PyBullet takes references
# to the numbers in the lists and never releases them. With lists that are made once and filled with other numbers for
# each mesh, the process does not grow. disconnect does not give the memory back either.
#
# Output seen:
#     new lists: grows by 10 MiB or more; the same lists: by less than 2 MiB
#     (measured: new lists 55 MiB, the same lists -12 MiB)
#
# Ends with status 1 where the behaviour has changed.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet numpy==2.4.6 pybullet==3.2.7
cat > "$folder/meshes.py" <<'PYTHON'
import gc
import math
import os
import sys

import pybullet

COUNT, MESHES, ROUNDS = 4608, 3, 15
kept = ([[0.0] * 3 for _ in range(COUNT)], [[0.0] * 3 for _ in range(COUNT)])


def resident_mib():
    gc.collect()
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def mesh(client, number, again):
    corners = [[math.cos(i + number), math.sin(i + number), (i % 7) + number / 3] for i in range(COUNT)]
    normals = [[0.0, 0.0, 1.0 + number / 1000 + i / 1e6] for i in range(COUNT)]
    if again:
        for rows, filled in zip((corners, normals), kept, strict=True):
            for row, place in zip(rows, filled, strict=True):
                place[:] = row
        corners, normals = kept
    return pybullet.createVisualShape(pybullet.GEOM_MESH, vertices=corners, normals=normals,
                                      indices=list(range(COUNT)), physicsClientId=client)


def round_of(client, number, again):
    for index in range(MESHES):
        pybullet.createMultiBody(0, -1, mesh(client, number * MESHES + index, again), physicsClientId=client)
    pybullet.resetSimulation(physicsClientId=client)


again = sys.argv[1] == "same"
client = pybullet.connect(pybullet.DIRECT)
for number in range(3):
    round_of(client, number, again)
before = resident_mib()
for number in range(3, 3 + ROUNDS):
    round_of(client, number, again)
pybullet.disconnect(client)
print(round(resident_mib() - before))
PYTHON
new=$("$folder/venv/bin/python" "$folder/meshes.py" new | tail -1)
same=$("$folder/venv/bin/python" "$folder/meshes.py" same | tail -1)
echo "measured: new lists $new MiB, the same lists $same MiB"
[ "$new" -ge 10 ] && [ "$same" -lt 2 ] && echo "new lists: grows by 10 MiB or more; the same lists: by less than 2 MiB"
