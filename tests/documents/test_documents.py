"""Commands and Python of the documents that take long, run as they are written: `make test-docs`, some minutes."""

import glob
import os
import re
import subprocess
import sys

import pytest
from documented import ROOT, commands, tutorial

# Not run: what needs other machines or their certificates, trains the vision for an hour, or names the reader's files.
ELSEWHERE = re.compile(r"HOST|ENDPOINT|HUB|NAME_OR_ADDRESS|tls|address|FOLDER|FILE|CHECKPOINT|RUN\b|my-scenes|--stages")
LONG = [
    command
    for command in commands()
    if command.block
    and command.document in ("README.md", "docs/usage.md")
    and not ELSEWHERE.search(str(command))
    and command.name not in ("pretrain", "monitor")
    and "--resume" not in command.words
]
pytestmark = pytest.mark.timeout(3600)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Folder with the configurations of the checkout and a run in `runs/NAME`."""
    folder = tmp_path_factory.mktemp("place")
    (folder / "configs").symlink_to(ROOT / "configs")
    run("launch", "--config", "smoke", "--plain", "--run-dir", "runs/NAME", cwd=folder)
    (folder / "runs" / "scattered-1").symlink_to(folder / "runs" / "NAME")
    return folder


def run(*words, cwd):
    command = [sys.executable, "-m", "zsdist", *words]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("command", LONG, ids=str)
def test_a_command_of_the_documents_does_its_work_as_it_is_written(place, command):
    words = [found for word in command.words for found in glob.glob(word, root_dir=place) or [word]]  # as a shell does
    assert run(command.name, *words, cwd=place)


def test_a_run_is_resumed_as_the_document_says(place):
    run("launch", "--resume", "runs/NAME", "--episodes", "12", "--plain", cwd=place)


def test_the_tutorial_can_be_followed_and_prints_what_it_shows(tmp_path):
    for command, shown in tutorial(tmp_path):
        words = [sys.executable, "-m", "zsdist", command.name, *command.words]
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == int("no way" in done.stdout), done.stderr
        printed = {" ".join(line.split()) for line in done.stdout.splitlines()}
        figures = [" ".join(line.split()) for line in shown if line.split()[0] in ("success", "collision", "ok")]
        assert set(figures) <= printed, (str(command), done.stdout)


@pytest.mark.parametrize("document", ["README.md", "docs/environment.md"])
def test_the_python_of_a_document_runs(document, tmp_path):
    for number, block in enumerate(re.findall(r"```python\n(.*?)```", (ROOT / document).read_text(), re.DOTALL)):
        file = tmp_path / f"block_{number}.py"
        file.write_text(block)
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        done = subprocess.run([sys.executable, file], cwd=ROOT, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
