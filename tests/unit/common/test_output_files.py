import json

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
