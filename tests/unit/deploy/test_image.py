"""The image: its instructions, and the checks of hadolint."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from deployments import DEPLOY, IMAGES, ROOT

DOCKERFILE = DEPLOY / "Dockerfile"


def stages() -> dict[str, list[tuple[str, str]]]:
    """Return the instructions of each stage, by its name."""
    text = re.sub(r"\\\n", " ", DOCKERFILE.read_text())
    found, current = {}, []
    for line in text.splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        name, argument = line.split(maxsplit=1)
        if name == "FROM":
            current = found.setdefault(argument.split()[-1], [])
        current.append((name, " ".join(argument.split())))
    return found


def chain(stage: str) -> list[tuple[str, str]]:
    """Return the instructions of a stage after those of the stages that it begins with."""
    instructions = stages()[stage]
    parent = instructions[0][1].split()[0]
    return [*(chain(parent) if parent in stages() else []), *instructions]


def test_the_linter_of_dockerfiles_has_nothing_to_say():
    linter = shutil.which("hadolint") or shutil.which("hadolint", path=str(Path(sys.executable).parent))
    if linter is None:
        pytest.skip("hadolint is not installed; make install does it")
    done = subprocess.run([linter, "--no-color", str(DOCKERFILE)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("target", ["cpu", "gpu"])
def test_an_image_has_its_packages_from_another_stage_and_ends_as_an_unprivileged_user(target):
    instructions = chain(target)
    assert "python:${PYTHON}" in instructions[0][1]
    assert ("COPY", f"--from=packages-{target} /opt/venv /opt/venv") in instructions
    users = [argument for name, argument in instructions if name == "USER"]
    assert users[-1].isdecimal() and users[-1] != "0"  # runAsNonRoot refuses a name
    assert not any("pip" in argument for name, argument in instructions if name == "RUN")
    assert "ARG PYTHON=3.11-slim" in DOCKERFILE.read_text()


def test_the_image_for_a_gpu_has_the_runtime_for_it_in_the_tested_version_and_not_the_other_one():
    instructions = " ".join(argument for _, argument in chain("packages-gpu"))
    assert "pip uninstall --yes onnxruntime" in instructions and "onnxruntime-gpu==" in instructions
    assert re.search(r"^onnxruntime==", (ROOT / "constraints.txt").read_text(), re.MULTILINE)


def test_any_user_of_group_0_may_write_the_folders_of_the_image_that_volumes_are_mounted_at():
    instructions = chain("cpu")
    home = next(argument for name, argument in reversed(instructions) if name == "WORKDIR")
    assert any(name == "ENV" and f"HOME={home}" in argument.split() for name, argument in instructions)
    (shared,) = [argument for name, argument in instructions if name == "RUN" and "chmod -R g=u ." in argument]
    assert "chown -R 1000:0 ." in shared and "mkdir -p runs journals" in shared


def test_only_files_that_exist_are_copied():
    for instructions in stages().values():
        for name, argument in instructions:
            if name == "COPY" and not argument.startswith("--from"):
                for source in argument.split()[:-1]:
                    assert (ROOT / source).exists(), source


def test_every_image_that_the_files_name_is_one_that_the_dockerfile_says_how_to_build():
    built = set(re.findall(r"--tag (\S+)", DOCKERFILE.read_text()))
    assert built == IMAGES == set(re.findall(r"--tag (\S+)", (DEPLOY / "README.md").read_text()))
