#!/bin/sh
# Minari 0.5.4: a process that is killed while it adds an episode leaves the whole data set unreadable, with all the
# episodes that it had before.
#
# Input: a set with pictures of 224 pixels in the format arrow, to which a process adds episodes one by one with
# `MinariStorage.update_episodes`, killed at random moments (SIGKILL).
# Behaviour: for each episode `metadata.json` of the set is written three times, in place. It holds the bounds of the
# observation space one by one, 1.4 MB for such a picture, so that most of the time goes into writing it. A kill
# meanwhile leaves a part of it, and `MinariStorage.read` raises JSONDecodeError. A copy of the file put aside before each
# episode, or a rename over it, would keep the set.
#
# Output seen:
#     20 kills: 6 of them left a set that cannot be read
#
# Ends with status 1 where the behaviour has changed.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet 'minari[arrow]==0.5.4' pillow==13.0.0
cat > "$folder/killed.py" <<'PYTHON'
import json
import os
import pathlib
import random
import shutil
import signal
import sys
import time

import numpy as np
from gymnasium import spaces
from minari.data_collector import EpisodeBuffer
from minari.dataset.minari_storage import MinariStorage

KILLS, PX = 20, 224
root = pathlib.Path(sys.argv[1])


def add_episodes(path, begun):
    storage = MinariStorage.new(
        path,
        observation_space=spaces.Box(0, 255, (PX, PX, 3), np.uint8),
        action_space=spaces.Discrete(5),
        data_format="arrow",
        jpeg_encoding=False,
    )
    picture = np.zeros((3, PX, PX, 3), np.uint8)
    flags = np.zeros(2, bool)
    for number in range(1000):
        storage.update_episodes([EpisodeBuffer(id=number, observations=picture, actions=np.zeros(2, np.int64),
                                               rewards=np.zeros(2), terminations=flags, truncations=flags)])
        begun.touch()


unreadable = 0
for kill in range(KILLS):
    path, begun = root / f"set-{kill}", root / f"begun-{kill}"
    child = os.fork()
    if not child:
        add_episodes(path, begun)
    while not begun.exists():
        time.sleep(0.01)
    time.sleep(random.Random(kill).uniform(0.0, 1.0))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    try:
        MinariStorage.read(path)
    except json.JSONDecodeError:
        unreadable += 1
    shutil.rmtree(path)
print(f"{KILLS} kills: {unreadable} of them left a set that cannot be read")
assert unreadable
PYTHON
"$folder/venv/bin/python" "$folder/killed.py" "$folder"
