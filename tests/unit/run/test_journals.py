from pathlib import Path

import pytest

from zsdist.config import parse
from zsdist.errors import RunError
from zsdist.run import journals

DISKS = ("/disks/a", "/disks/b")


def of(shard, *, folders=DISKS, folder="/runs/x", start="s1"):
    return journals.of_shard(parse({"replay": {"journals": list(folders)}}), "x", Path(folder), start, shard)


def test_journals_lie_in_the_run_directory_unless_they_have_disks_of_their_own():
    assert of(1, folders=()) == Path("/runs/x/journal/s1-1")
    assert [of(shard).parent for shard in range(3)] == [Path("/disks/a"), Path("/disks/b"), Path("/disks/a")]


def test_no_two_shards_starts_or_runs_share_a_folder():
    folders = [of(0), of(2), of(0, start="s2"), of(0, folder="/elsewhere/x")]
    assert len(set(folders)) == len(folders)


def test_a_shard_removes_what_earlier_starts_of_its_run_have_left_and_nothing_else(tmp_path):
    config = parse({"replay": {"journals": [str(tmp_path)]}})
    old, other_shard = (journals.of_shard(config, "x", Path("/runs/x"), "s1", shard) for shard in (0, 1))
    other_run = journals.of_shard(config, "x", Path("/elsewhere/x"), "s1", 0)
    for folder in (old, other_shard, other_run):
        (folder / "low").mkdir(parents=True)
    own = journals.begin(config, "x", Path("/runs/x"), "s2", 0)
    assert not old.exists() and other_shard.exists() and other_run.exists() and own.parent == tmp_path
    own.mkdir()
    assert journals.begin(config, "x", Path("/runs/x"), "s2", 0) == own and own.exists()


def test_a_shard_that_comes_back_without_the_disk_of_its_predecessor_is_refused(tmp_path):
    config = parse({"replay": {"journals": [str(tmp_path)]}})
    where = (config, "x", Path("/runs/x"), "s1", 0)
    with pytest.raises(RunError, match=r"its journal .*-s1-0 is not there"):
        journals.begin(*where, has_predecessor=True)
    journals.begin(*where).mkdir()
    journals.begin(*where, has_predecessor=True)
    in_the_run_directory = parse({})  # where the replay itself tells what is missing
    journals.begin(in_the_run_directory, *where[1:], has_predecessor=True)
