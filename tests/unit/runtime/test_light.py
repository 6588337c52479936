"""The environment of a runner: nothing of the training stack is loaded, nor anything that `make runtime` omits."""

import os
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[3]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
GROUP = {canonicalize_name(Requirement(text).name) for text in PYPROJECT["dependency-groups"]["runtime"]}
THEIRS = {"llvmlite", "annotated-types", "pydantic-core", "typing-extensions", "typing-inspection", "flatbuffers",
          "protobuf", "packaging"}  # fmt: skip
OURS = {"zsdist"}
QUIET = "ORT_DISABLE_TELEMETRY"  # onnxruntime reads it at its import
BLOCKED = """
import os
import sys
from importlib.machinery import PathFinder

class Filtered:
    find_distributions = PathFinder.find_distributions

    @staticmethod
    def find_spec(name, path=None, target=None):
        assert name != "onnxruntime" or quiet in os.environ, "onnxruntime would report its use"
        return None if name.partition(".")[0] in blocked else PathFinder.find_spec(name, path, target)

sys.meta_path[sys.meta_path.index(PathFinder)] = Filtered
"""
CHECK = """
from zsdist.__main__ import main
sys.argv = ["zsdist", "export", "--check", sys.argv[1]]
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
print(*sorted({name.partition(".")[0] for name in sys.modules}))
"""
COMMAND = """
from zsdist.__main__ import main
sys.argv[0] = "zsdist"
main()
"""


def outside():
    """All installed modules that a runner's environment lacks, by their names at the top."""
    tops = packages_distributions()
    known = {top: {canonicalize_name(name) for name in names} for top, names in tops.items()}
    return {top for top, names in known.items() if not names & (GROUP | THEIRS | OURS)}


def run(code, *arguments):
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env={name: value for name, value in os.environ.items() if name != QUIET} | {"PYTHONPATH": str(ROOT)},
    )


def without(blocked):
    return f"blocked, quiet = {blocked!r}, {QUIET!r}\n{BLOCKED}"


def test_a_bundle_is_checked_without_what_a_runners_environment_lacks(small_bundle):
    blocked = outside()
    assert {"torch", "ray", "pybullet", "scipy", "gymnasium", "rich", "onnx"} <= blocked
    done = run(without(blocked) + CHECK, small_bundle)
    assert done.returncode == 0, done.stderr
    said, loaded = done.stdout.splitlines()[-2:]
    assert "passes: the same decisions in all 12 steps" in said
    assert not set(loaded.split()) & {"torch", "ray", "pybullet", "scipy"}


@pytest.mark.parametrize("words", [("evaluate", "--list"), ("export", "pretrained", "--out", "bundle")])
def test_a_command_that_needs_more_says_so_in_one_line(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    done = run(without(outside()) + COMMAND, *words)
    assert done.returncode == 2 and list(tmp_path.iterdir()) == []
    assert done.stderr.count("\n") == 1 and "is not installed here; allowed is" in done.stderr


def test_the_group_of_a_runner_has_the_ranges_of_the_package():
    assert set(PYPROJECT["dependency-groups"]["runtime"]) <= set(PYPROJECT["project"]["dependencies"])
