import ast
from pathlib import Path

import zsdist
from zsdist.common import folders

PACKAGE = Path(zsdist.__file__).parent
LISTING = {"glob", "rglob", "iterdir", "listdir", "scandir", "walk"}


def test_hidden_files_and_all_in_hidden_folders_are_left_out(tmp_path):
    for name in ("b/2.pem", "a/1.pem", "a/.DS_Store", "a/._1.pem", ".c/3.pem", "a/.4.partial/5.pem"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "b" / ".#2.pem").symlink_to("somebody@elsewhere")
    assert folders.visible(tmp_path, "**/*.pem") == [tmp_path / "a/1.pem", tmp_path / "b/2.pem"]
    assert folders.visible(tmp_path) == [tmp_path / "a", tmp_path / "b"]
    assert folders.visible(tmp_path / ".c", "*.pem") == [tmp_path / ".c/3.pem"]
    assert folders.visible(tmp_path / "missing") == []


def test_numbers_are_in_order_whatever_their_width(tmp_path):
    for name in ("99", "100", "0007", "7a", "-3", "٣", "1 copy"):
        (tmp_path / name).touch()
    assert [path.name for path in folders.numbered(tmp_path)] == ["0007", "99", "100"]


def test_no_other_module_lists_a_folder():
    found = [
        f"{path.relative_to(PACKAGE)}:{node.lineno}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in LISTING
        and not (isinstance(node.func.value, ast.Name) and node.func.value.id in ("ast", "walker"))
    ]  # fmt: skip
    # The undertaker is one file that runs without the package, and lists processes.
    assert [place for place in found if not place.startswith(("common/folders.py", "run/undertaker.py"))] == []
