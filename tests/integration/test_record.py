import subprocess
import sys
import time

import numpy as np
import pytest

from zsdist.recording.episode import read_episode
from zsdist.recording.recorded_set import RecordedSet

pytestmark = pytest.mark.integration
SMALL = ("--scenes", "singleton", "--workers", "1", "--set", "sim.max_steps=15", "--set", "camera.size_px=64")


def command(out, episodes, *more):
    words = [sys.executable, "-m", "zsdist.record", "random", *SMALL, "--episodes", str(episodes), "--out", str(out)]
    return [*words, *more]


def test_a_recording_that_was_killed_goes_on_and_ends_as_if_it_had_not_been(tmp_path):
    out = tmp_path / "killed"
    process = subprocess.Popen(command(out, 1000), stdout=subprocess.DEVNULL)
    while not (out / "episode-000001.mcap").exists() or not list(out.glob(".*.partial")):
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    finished = RecordedSet(out).episodes()
    assert len(finished) >= 2 and all(len(read_episode(path).actions) for path in finished.values())
    count = len(finished) + 1
    subprocess.run(command(out, count, "--resume"), check=True, stdout=subprocess.DEVNULL)
    subprocess.run(command(tmp_path / "whole", count), check=True, stdout=subprocess.DEVNULL)
    killed, whole = (RecordedSet(folder).episodes() for folder in (out, tmp_path / "whole"))
    assert list(killed) == list(whole) == list(range(count))
    for number in killed:
        one, other = read_episode(killed[number]), read_episode(whole[number])
        assert np.array_equal(one.poses, other.poses) and np.array_equal(one.pictures, other.pictures)
    assert not list(out.glob(".*.partial"))
