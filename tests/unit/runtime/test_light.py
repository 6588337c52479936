"""The environment of a runner: nothing of the training stack is loaded, nor anything that `make runtime` omits."""

import os
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[3]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
GROUP = {canonicalize_name(Requirement(text).name) for text in PYPROJECT["dependency-groups"]["runtime"]}
THEIRS = {"llvmlite", "annotated-types", "pydantic-core", "typing-extensions", "typing-inspection", "flatbuffers",
          "protobuf", "packaging"}  # fmt: skip
OURS = {"zsdist"}
BLOCKED = """
import sys
from importlib.abc import MetaPathFinder

class Blocked(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in blocked:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Blocked())
"""
CHECK = """
import runpy
sys.argv = ["zsdist.export", "--check", sys.argv[1]]
try:
    runpy.run_module("zsdist.export", run_name="__main__")
except SystemExit as end:
    assert not end.code, end.code
print(*sorted({name.partition(".")[0] for name in sys.modules}))
"""


def outside():
    """All installed modules that a runner's environment lacks, by their names at the top."""
    tops = packages_distributions()
    known = {top: {canonicalize_name(name) for name in names} for top, names in tops.items()}
    return {top for top, names in known.items() if not names & (GROUP | THEIRS | OURS)}


def test_a_bundle_is_checked_without_what_a_runners_environment_lacks(small_bundle):
    blocked = outside()
    assert {"torch", "ray", "pybullet", "scipy", "gymnasium", "rich", "onnx"} <= blocked
    code = f"blocked = {blocked!r}\n{BLOCKED}{CHECK}"
    done = subprocess.run(
        [sys.executable, "-c", code, str(small_bundle)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stderr
    said, loaded = done.stdout.splitlines()[-2:]
    assert "passes: the same decisions in all 12 steps" in said
    assert not set(loaded.split()) & blocked


def test_where_the_training_stack_is_installed_too_it_stays_on_disk(small_bundle):
    done = subprocess.run(
        [sys.executable, "-c", "import sys" + CHECK, str(small_bundle)],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    loaded = done.stdout.splitlines()[-1].split()
    assert not set(loaded) & {"torch", "ray", "pybullet"}  # numba asks scipy for its version where it is installed


def test_the_group_of_a_runner_has_the_ranges_of_the_package():
    assert set(PYPROJECT["dependency-groups"]["runtime"]) <= set(PYPROJECT["project"]["dependencies"])
