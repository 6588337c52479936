import ast
import shutil
from pathlib import Path

import zsdist
from zsdist.common import code_hash

PACKAGE = Path(zsdist.__file__).parent


def test_words_and_layout_change_no_hash_and_statements_do():
    plain = ast.parse("def f(x):\n    return x + 1")
    worded = ast.parse('"""Of a module."""\ndef f(x):  # adds\n    """Adds."""\n\n    return (x + 1)')
    assert code_hash._statements(plain) == code_hash._statements(worded)
    assert code_hash._statements(plain) != code_hash._statements(ast.parse("def f(x):\n    return x + 2"))


def test_a_hash_is_of_the_modules_below_its_roots():
    camera, vision = code_hash.modules("zsdist.sim.env"), code_hash.modules("zsdist.vision.visual_act")
    assert "zsdist.sim.camera.shading" in camera and "zsdist.vision.encoders.lite0" in vision
    assert "zsdist.sim.camera.shading" not in vision and "zsdist.config" not in camera | vision
    assert code_hash.modules("zsdist.sim.env", "zsdist.vision.visual_act") == camera | vision
    assert len({code_hash.sha256("zsdist.sim.env"), code_hash.sha256("zsdist.vision.visual_act")}) == 2


def made(tmp_path, monkeypatch, files: dict[str, str]) -> str:
    """Hash of `zsdist.top` in a package of these files."""
    shutil.rmtree(tmp_path / "package", ignore_errors=True)
    for name, text in files.items():
        file = tmp_path / "package" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    monkeypatch.setattr(code_hash, "_PACKAGE", tmp_path / "package")
    for cached in (code_hash.sha256, code_hash._module_hash):
        cached.cache_clear()
    return code_hash.sha256("zsdist.top")


def test_a_module_may_move_and_imports_be_sorted_anew_but_no_content_may_change(tmp_path, monkeypatch):
    here = {"top.py": "from zsdist.a import f\nfrom zsdist.b import g\n", "a.py": "def f(): return 1", "b.py": "g = 2"}
    before = made(tmp_path, monkeypatch, here)
    moved = {
        "top.py": "from zsdist.b import g\nfrom zsdist.far.off import f\n",
        "far/off.py": "def f(): return 1",
        "b.py": "g = 2",
    }
    assert made(tmp_path, monkeypatch, moved) == before
    assert made(tmp_path, monkeypatch, here | {"a.py": "def f(): return 2"}) != before
    swapped = {"top.py": "from zsdist.a import g as f\nfrom zsdist.a import f as g\n", "a.py": "f = g = 1"}
    straight = {"top.py": "from zsdist.a import f\nfrom zsdist.a import g\n", "a.py": "f = g = 1"}
    assert made(tmp_path, monkeypatch, swapped) != made(tmp_path, monkeypatch, straight)


def test_an_import_is_of_the_content_that_it_names(tmp_path, monkeypatch):
    both = {"a.py": "def f(): return 1", "b.py": "def f(): return 2"}
    use = "from zsdist.{} import f\nfrom zsdist.{} import f as other\n"
    first = made(tmp_path, monkeypatch, both | {"top.py": use.format("a", "b")})
    assert made(tmp_path, monkeypatch, both | {"top.py": use.format("b", "a")}) != first
