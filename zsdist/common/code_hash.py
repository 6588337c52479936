"""Hash of the package's own code, which matches stored results with the code that made them."""

import ast
import hashlib
from functools import cache
from pathlib import Path
from typing import TypeGuard

import zsdist

DIGITS = 16  # hexadecimal digits of a hash
PACKAGE = Path(zsdist.__file__).parent
APART = (  # modules that no hash covers
    "zsdist.config",  # settings are hashed as values
    "zsdist.errors",  # errors and processes determine no result
    "zsdist.common.process_pool",
)


@cache
def sha256(*roots: str, package: Path = PACKAGE) -> str:
    """Return the hash of the modules `roots` and of all modules of the package that they import, however indirectly.

    It covers statements, but no comments, docstrings or module paths: where a module is imported, the hash of its
    content stands in place of its path, so a module may be moved without changing the hash.

    Args:
        roots: names of modules, such as `zsdist.sim.env`.
        package: folder of the modules whose names begin with `zsdist.`; it is read once.
    """
    return _digest(sorted(_module_hash(root, package) for root in roots))


def modules(*roots: str, package: Path = PACKAGE) -> set[str]:
    """Return the names of the modules that `sha256` covers for the same arguments."""
    found: set[str] = set()
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += [module for _, modules in _imports(_tree(name, package), package) for module in modules]
    return found


@cache
def _module_hash(name: str, package: Path) -> str:
    tree = _tree(name, package)
    imports = [
        f"{names} {' '.join(_module_hash(module, package) for module in modules)}"
        for names, modules in _imports(tree, package)
    ]
    return _digest([_statements(tree), *sorted(imports)])


def _imports(tree: ast.Module, package: Path) -> list[tuple[str, list[str]]]:
    """Return each import from the package as `name as alias`, with the hashed modules that the name comes from."""
    found = []
    for node in filter(_is_own_import, ast.walk(tree)):
        for alias in node.names:
            origins = (str(node.module), f"{node.module}.{alias.name}")
            found.append((f"{alias.name} as {alias.asname}", [name for name in origins if _is_hashed(name, package)]))
    return found


def _statements(tree: ast.Module) -> str:
    """Return a module's statements as text without docstrings and imports from the package; changes the tree."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body = node.body[1:]
        body = getattr(node, "body", None)
        if isinstance(body, list):
            body[:] = [statement for statement in body if not _is_own_import(statement)]
    return ast.dump(tree)


def _is_own_import(node: ast.AST) -> TypeGuard[ast.ImportFrom]:
    return isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "zsdist"


def _is_hashed(name: str, package: Path) -> bool:
    return name not in APART and name != "zsdist" and _file(name, package) is not None


def _tree(name: str, package: Path) -> ast.Module:
    file = _file(name, package)
    if file is None:
        raise ModuleNotFoundError(f"module {name} is not in {package}")
    return ast.parse(file.read_text(encoding="utf-8"))


def _file(name: str, package: Path) -> Path | None:
    path = package.joinpath(*name.split(".")[1:])
    files = (path.with_suffix(".py"), path / "__init__.py")
    return next((file for file in files if file.is_file()), None)


def _digest(texts: list[str]) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:DIGITS]
