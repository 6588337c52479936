import itertools
import os
import subprocess
import sys

import pytest

from zsdist.common import code_hash


@pytest.fixture
def hash_of(tmp_path):
    """Return the hash of `zsdist.top` in a package of the given files."""
    numbers = itertools.count()

    def make(files: dict[str, str]) -> str:
        package = tmp_path / f"package-{next(numbers)}"
        for name, text in files.items():
            file = package / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
        return code_hash.sha256("zsdist.top", package=package)

    return make


def test_words_and_layout_change_no_hash_and_statements_do(hash_of):
    plain = hash_of({"top.py": "def f(x):\n    return x + 1"})
    worded = '"""Module."""\ndef f(x):  # adds\n    """Add."""\n\n    return (x + 1)'
    assert hash_of({"top.py": worded}) == plain
    assert hash_of({"top.py": "def f(x):\n    return x + 2"}) != plain


def test_a_hash_covers_the_modules_that_its_roots_import():
    camera, vision = code_hash.modules("zsdist.sim.env"), code_hash.modules("zsdist.vision.visual_act")
    assert "zsdist.sim.camera.shading" in camera and "zsdist.vision.encoders.lite0" in vision
    assert "zsdist.sim.camera.shading" not in vision and "zsdist.config" not in camera | vision
    assert code_hash.modules("zsdist.sim.env", "zsdist.vision.visual_act") == camera | vision
    assert len({code_hash.sha256("zsdist.sim.env"), code_hash.sha256("zsdist.vision.visual_act")}) == 2


def test_a_module_that_does_not_exist_has_no_hash():
    with pytest.raises(ModuleNotFoundError, match=r"zsdist\.nowhere"):
        code_hash.sha256("zsdist.nowhere")


def test_a_module_may_move_and_imports_be_sorted_anew_but_no_content_may_change(hash_of):
    here = {"top.py": "from zsdist.a import f\nfrom zsdist.b import g\n", "a.py": "def f(): return 1", "b.py": "g = 2"}
    before = hash_of(here)
    moved = {
        "top.py": "from zsdist.b import g\nfrom zsdist.far.off import f\n",
        "far/off.py": "def f(): return 1",
        "b.py": "g = 2",
    }
    assert hash_of(moved) == before
    assert hash_of(here | {"a.py": "def f(): return 2"}) != before
    swapped = {"top.py": "from zsdist.a import g as f\nfrom zsdist.a import f as g\n", "a.py": "f = g = 1"}
    straight = {"top.py": "from zsdist.a import f\nfrom zsdist.a import g\n", "a.py": "f = g = 1"}
    assert hash_of(swapped) != hash_of(straight)


def test_an_import_is_hashed_by_the_content_that_it_names(hash_of):
    both = {"a.py": "def f(): return 1", "b.py": "def f(): return 2"}
    use = "from zsdist.{} import f\nfrom zsdist.{} import f as other\n"
    assert hash_of(both | {"top.py": use.format("a", "b")}) != hash_of(both | {"top.py": use.format("b", "a")})


def test_a_locale_without_utf_8_changes_no_hash():
    command = [sys.executable, "-c", "from zsdist.common import code_hash; print(code_hash.sha256('zsdist.sim.env'))"]
    ascii_only = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    found = subprocess.run(command, capture_output=True, text=True, check=True, env=ascii_only)
    assert found.stdout.strip() == code_hash.sha256("zsdist.sim.env")
