"""The laws of the house: names, sizes, words and imports that hold in the whole package."""

import ast
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest

import zsdist

PACKAGE = Path(zsdist.__file__).parent
TREES = {path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text()) for path in sorted(PACKAGE.rglob("*.py"))}
DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
RIDDLE = re.compile(r"(What|How|Who|Whom|Whose|Which|By|Where|Whether|When|Why)\b")
HEAVY = {"torch", "ray", "pybullet", "scipy"}
AMOUNTS = re.compile(
    r"\b(cpu_count|process_cpu_count|virtual_memory|sched_getaffinity|SC_PHYS_PAGES|SC_NPROCESSORS_\w+|meminfo|cpuinfo)\b"
)
CACHES = re.compile(r"\b(ZSDIST_CACHE|NUMBA_CACHE_DIR|MPLCONFIGDIR|XDG_CACHE_HOME|getuser|getlogin)\b")
PUBLIC_ALL_THE_SAME = {
    "os._exit",  # documented under this name, as the next is
    "sys._current_frames",
    "ray._private.state.available_resources_per_node",  # for developers; nothing else says what each node has left
}
INSIDE_RAY = {  # starts that have no switch; only in releases with which it was tried
    "run/ray_lean.py": [
        "ray._private.node",
        "ray._private.ray_constants",
        "ray._private.services",
        "ray._raylet.persist_port",
    ]
}
LIGHT_PACKAGES = ("driving", "agent", "planning", "runtime", "ros2", "piloting")
LIGHT_MODULES = ("zsdist.vision.visual_act", "zsdist.vision.reading_cache", "zsdist.vision.ray_ablation")


def public_classes() -> dict[str, list[str]]:
    homes = defaultdict(list)
    for name, tree in TREES.items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].append(name)
    return homes


def private_members_of_libraries(tree: ast.Module) -> list[str]:
    """Names that begin with an underscore and belong to another library, as `module.name`."""
    outside, found = {}, []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [(alias.asname or alias.name.split(".")[0], alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [(alias.asname or alias.name, f"{node.module}.{alias.name}") for alias in node.names]
        else:
            continue
        outside |= {local: whole for local, whole in names if whole.split(".")[0] != "zsdist"}
        found += [whole for _, whole in names if not whole.startswith("__") and "._" in whole and "zsdist" not in whole]
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr.startswith("_") and not node.attr.startswith("__"):
            root = node.value
            while isinstance(root, ast.Attribute):
                root = root.value
            if isinstance(root, ast.Name) and root.id in outside:
                found.append(f"{outside[root.id]}.{node.attr}")
    return sorted(set(found) - PUBLIC_ALL_THE_SAME)


def test_a_public_class_name_means_one_thing():
    assert {name: homes for name, homes in public_classes().items() if len(homes) > 1} == {}


def test_docstrings_begin_with_a_noun_or_a_verb():
    riddles = [
        f"{name}: {text.splitlines()[0]}"
        for name, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, DOCUMENTED) and RIDDLE.match(text := ast.get_docstring(node) or "")
    ]
    assert riddles == []


def test_files_and_classes_are_short():
    long_files = {name: lines for name in TREES if (lines := len((PACKAGE / name).read_text().splitlines())) > 400}
    long_classes = {
        f"{name}:{node.name}": node.end_lineno - node.lineno + 1
        for name, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and node.end_lineno - node.lineno + 1 > 300
    }
    assert (long_files, long_classes) == ({}, {})


def test_no_private_member_of_a_library_is_used():
    found = {name: members for name, tree in TREES.items() if (members := private_members_of_libraries(tree))}
    assert found == INSIDE_RAY


def test_only_one_file_asks_for_the_amounts_of_cores_and_memory():
    asking = {name for name in TREES if AMOUNTS.search((PACKAGE / name).read_text())}
    assert asking == {"common/allowed_resources.py"}


def test_only_one_file_chooses_the_folders_of_caches():
    asking = {name for name in TREES if CACHES.search((PACKAGE / name).read_text())}
    assert asking == {"common/cache_folder.py"}


@pytest.mark.parametrize(
    "line",
    ["import torch\ntorch._fused_adam_()", "from numpy import core as c\nc.a._b", "from numpy import _core"],
)
def test_the_reader_of_private_members_notices_one(line):
    assert private_members_of_libraries(ast.parse(line))


@pytest.mark.parametrize("light", [*LIGHT_PACKAGES, "vision"])
def test_what_drives_works_without_heavy_libraries(light):
    modules = list(LIGHT_MODULES)
    if light != "vision":
        modules = [f"zsdist.{name.removesuffix('.py').replace('/', '.')}" for name in TREES if name.startswith(light)]
    code = f"import importlib, sys\nsys.modules.update(dict.fromkeys({HEAVY}))\n"  # importing one of them now fails
    code += "\n".join(f"importlib.import_module({module.removesuffix('.__init__')!r})" for module in modules)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_text_files_are_utf_8_in_every_locale():
    """Without an encoding, the locale decides: a batch job with LC_ALL=C reads other texts than a shell writes."""
    unstated = [
        f"{name}, line {node.lineno}"
        for name, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and opens_text(node) and "encoding" not in {word.arg for word in node.keywords}
    ]
    assert unstated == []


def opens_text(call: ast.Call) -> bool:
    """Whether a call reads or writes a text file: `read_text`, `write_text`, `open` without "b" in its mode."""
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    modes = [node.value for node in call.args if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    owner = call.func.value if isinstance(call.func, ast.Attribute) else None
    if name == "open" and isinstance(owner, ast.Name | ast.Attribute) and not modes:
        return False  # `os.open`, `zenoh.open`, `limiter.open`
    return name in ("read_text", "write_text") or (name == "open" and not any("b" in mode for mode in modes))
