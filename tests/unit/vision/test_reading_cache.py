import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from zsdist.errors import ConfigError, RunError
from zsdist.types import LatticeState
from zsdist.vision import reading_cache
from zsdist.vision.reading import Reading
from zsdist.vision.reading_cache import HEAD_BYTES, SET_BYTES, SHAPES, SLOT_BYTES, WAYS, ReadingCache

HERE = LatticeState(3, 4, 5)
WRITER = """
import sys

sys.path.insert(0, sys.argv[2])
from test_reading_cache import numbered
from zsdist.types import LatticeState
from zsdist.vision.rays import BINS
from zsdist.vision.reading_cache import ReadingCache
cache = ReadingCache(int(sys.argv[1]), "vision")
print("ready", flush=True)
number = 0
while True:
    number += 1
    cache.keep("scene", LatticeState(number % 7, 0, 0), numbered(number % BINS))
"""


@pytest.fixture(autouse=True)
def temporary_folder(tmp_path, monkeypatch):
    """Return the folder for temporary files of this process and of those that it starts."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    return tmp_path


def opened(size_bytes=64 * SET_BYTES, vision="vision"):
    return ReadingCache(size_bytes, vision)


def reading(seed=0):
    rng = np.random.default_rng(seed)
    clearance, dynamic, rays = (rng.random(shape, np.float32) for shape in SHAPES)
    return Reading(clearance / clearance.sum(-1, keepdims=True), dynamic, rays / rays.sum(-1, keepdims=True))


def numbered(number):
    """Return a reading whose parts all encode a number below `BINS`."""
    clearance, dynamic, rays = (np.zeros(shape, np.float32) for shape in SHAPES)
    clearance[:, number] = rays[:, number] = 1
    return Reading(clearance, dynamic + number, rays)


def assert_equal(one, other):
    for left, right in zip(one, other, strict=True):
        np.testing.assert_array_equal(left, right)


def kill(process):
    """End a process with SIGKILL."""
    process.kill()
    process.wait()
    process.stdout.close()


def files_in(folder):
    return list(folder.glob(f"{reading_cache.PREFIX}*"))


def writer(size_bytes):
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(size_bytes), str(Path(__file__).parent)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "ready\n"
    return process


def test_a_stored_reading_is_found_by_every_cache_as_returned_and_close_to_the_original():
    one, other = opened(), opened()
    assert one.find("scene", HERE) is None
    kept = one.keep("scene", HERE, reading())
    assert_equal(kept, other.find("scene", HERE))
    for found, given, shape in zip(kept, reading(), SHAPES, strict=True):
        assert found.dtype == np.float32 and found.shape == shape
        np.testing.assert_allclose(found, given, atol=1e-3)
    np.testing.assert_allclose(kept.rays.sum(-1), 1, atol=1e-6)


@pytest.mark.parametrize(
    ("vision", "scene", "state"),
    [("other", "scene", HERE), ("vision", "other", HERE)]
    + [("vision", "scene", HERE._replace(**{name: 1})) for name in HERE._fields],
)
def test_a_reading_belongs_to_its_vision_scene_cell_and_heading(vision, scene, state):
    opened().keep("scene", HERE, reading())
    assert opened(vision=vision).find(scene, state) is None


def used_slots(file):
    """Return the offsets of the slots that are not empty."""
    content = file.read_bytes()
    return [at for at in range(0, len(content), SLOT_BYTES) if any(content[at : at + SLOT_BYTES])]


def overwrite(file, at, content):
    """Overwrite a part of the file, which caches have mapped into memory."""
    with file.open("r+b") as stream:
        stream.seek(at)
        stream.write(content)


def test_a_reading_with_any_wrong_byte_is_not_found(temporary_folder):
    cache = opened(SET_BYTES)
    cache.keep("scene", HERE, reading())
    (file,) = files_in(temporary_folder)
    (begin,) = used_slots(file)
    for at in (0, 20, HEAD_BYTES, HEAD_BYTES + 900, SLOT_BYTES - 1):
        byte = file.read_bytes()[begin + at]
        overwrite(file, begin + at, bytes([byte ^ 1]))
        assert cache.find("scene", HERE) is None
        overwrite(file, begin + at, bytes([byte]))
    assert cache.find("scene", HERE) is not None


def test_a_half_written_slot_is_overwritten(temporary_folder):
    cache = opened(SET_BYTES)
    cache.keep("scene", HERE, reading(1))
    (file,) = files_in(temporary_folder)
    (begin,) = used_slots(file)
    overwrite(file, begin + HEAD_BYTES, bytes(500 - HEAD_BYTES))
    assert cache.find("scene", HERE) is None
    assert_equal(cache.keep("scene", HERE, reading(2)), cache.find("scene", HERE))
    assert len(used_slots(file)) == 1


def test_the_file_never_grows_and_new_readings_replace_old_ones(temporary_folder):
    size = 2 * SET_BYTES + 5
    cache = opened(size)
    for number in range(100):
        cache.keep(f"scene {number}", HERE, reading(number))
        assert cache.find(f"scene {number}", HERE) is not None
    assert sum(cache.find(f"scene {number}", HERE) is not None for number in range(100)) == 2 * WAYS
    (file,) = files_in(temporary_folder)
    assert file.stat().st_size == 2 * SET_BYTES <= size and file.stat().st_blocks * 512 >= 2 * SET_BYTES
    assert file.stat().st_mode & 0o777 == 0o600


def test_a_writer_killed_at_any_moment_leaves_whole_readings_or_none():
    cache = opened(SET_BYTES)
    for _ in range(2):
        process = writer(SET_BYTES)
        seen = 0
        while seen < 300:  # readings of another process, while it overwrites them
            for ix in range(7):
                found = cache.find("scene", LatticeState(ix, 0, 0))
                if found is not None:
                    seen += 1
                    assert_equal(found, numbered(int(found.dynamic[0])))
        kill(process)
        for ix in range(7):
            place = LatticeState(ix, 1, 0)
            assert_equal(cache.keep("scene", place, reading(ix)), cache.find("scene", place))


def test_a_later_run_finds_readings_of_an_earlier_one_even_if_a_writer_was_killed():
    size = 64 * SET_BYTES  # with room for the other process's readings
    one = opened(size)
    kept = one.keep("scene", LatticeState(1, 1, 1), reading())
    one.close()
    kill(writer(size))
    assert_equal(opened(size).find("scene", LatticeState(1, 1, 1)), kept)


def test_an_unused_file_of_another_size_is_removed(temporary_folder):
    sizes = [SET_BYTES * count for count in (1, 2, 3)]
    process, two = writer(sizes[0]), opened(sizes[1])
    assert {path.stat().st_size for path in files_in(temporary_folder)} == set(sizes[:2])
    kill(process)
    three = opened(sizes[2])
    assert {path.stat().st_size for path in files_in(temporary_folder)} == set(sizes[1:])
    two.close()
    three.close()
    opened(sizes[2])
    assert {path.stat().st_size for path in files_in(temporary_folder)} == set(sizes[2:])


def test_sizes_without_room_are_refused_in_one_line(monkeypatch):
    with pytest.raises(ConfigError, match=rf"vision\.cache_bytes is 100; allowed are 0 .* {SET_BYTES} or more"):
        opened(100)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(reading_cache.os, "posix_fallocate", full)
    with pytest.raises(RunError, match=r"vision\.cache_bytes is .* cannot be created \(No space left on device\)"):
        opened()


def test_a_file_of_another_user_is_not_trusted(monkeypatch):
    opened().close()
    owner = os.getuid()
    monkeypatch.setattr(reading_cache.os, "getuid", lambda: owner + 1)
    with pytest.raises(RunError, match=r"cannot be created \(it belongs to another user\)"):
        opened()


def test_a_symbolic_link_is_not_followed(temporary_folder, tmp_path_factory):
    target = tmp_path_factory.mktemp("else") / "file"
    target.write_bytes(b"precious")
    os.symlink(target, temporary_folder / f"{reading_cache.PREFIX}{64 * SET_BYTES}")
    with pytest.raises(RunError, match="cannot be created"):
        opened()
    assert target.read_bytes() == b"precious"


def test_a_machine_without_a_folder_for_temporary_files_is_told_what_to_set(monkeypatch):
    def nowhere():
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr("tempfile.gettempdir", nowhere)
    with pytest.raises(RunError, match=r"vision\.cache_bytes is .*TMPDIR.*vision\.cache_bytes to 0"):
        opened()
