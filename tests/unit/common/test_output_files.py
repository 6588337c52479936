import errno
import json
import os

import pytest

from zsdist.common import output_files
from zsdist.errors import RunError


def test_a_result_is_written_as_json(tmp_path):
    file = tmp_path / "result.json"
    output_files.check_writable("--json", file)
    output_files.write_json("--json", file, {"success": 0.5})
    assert json.loads(file.read_text()) == {"success": 0.5}


@pytest.mark.parametrize("place", [".", "no-such-folder/result.json"])
def test_a_path_that_cannot_be_a_file_is_refused_with_its_option(tmp_path, place):
    with pytest.raises(RunError, match=r"--out is .*; allowed is a file in a folder that exists"):
        output_files.check_place("--out", tmp_path / place)


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), RunError("in use"), SystemExit()])
def test_a_folder_that_is_made_for_nothing_does_not_stay(tmp_path, error):
    before = tmp_path / "before"
    before.mkdir()
    for folder in (tmp_path / "one" / "two", before):
        with pytest.raises((RunError, SystemExit)), output_files.made_folder("--out", folder):
            assert folder.is_dir()
            raise error
    assert list(tmp_path.iterdir()) == [before]


def test_a_folder_that_is_made_stays_with_what_is_in_it(tmp_path):
    with output_files.made_folder("--out", tmp_path / "one" / "empty"):
        pass
    with pytest.raises(RunError), output_files.made_folder("--out", tmp_path / "two" / "full"):
        (tmp_path / "two" / "full" / "part").touch()
        raise RunError("in use")
    assert (tmp_path / "one" / "empty").is_dir() and (tmp_path / "two" / "full" / "part").is_file()
