"""Hash of the package's own code, by which stored results are matched with the code that made them."""

import ast
import hashlib
from functools import cache
from pathlib import Path

import zsdist

DIGITS = 16  # of a hash in hexadecimal
APART = (
    "zsdist.config",
    "zsdist.errors",
    "zsdist.common.process_pool",
)  # settings are hashed as values; the others do nothing
_PACKAGE = Path(zsdist.__file__).parent


@cache
def sha256(*roots: str) -> str:
    """Hash of the modules `roots` and of every module of the package that they import, directly or through others.

    It covers statements, not comments, docstrings or the places of modules: a module's path counts for nothing, and
    where a module is imported, the hash of its content stands in place of the path.
    """
    return _digest(sorted(map(_module_hash, roots)))


def modules(*roots: str) -> set[str]:
    """Names of the package's modules that `roots` need, themselves included, without `APART`."""
    found, waiting = set(), list(roots)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += [module for _, modules in _imports(_tree(name)) for module in modules]
    return found


@cache
def _module_hash(name: str) -> str:
    tree = _tree(name)
    imports = [f"{names} {' '.join(map(_module_hash, modules))}" for names, modules in _imports(tree)]
    return _digest([_statements(tree), *sorted(imports)])


def _imports(tree: ast.Module) -> list[tuple[str, list[str]]]:
    """Each name that is imported from the package, as `name as alias`, with the hashed modules that it comes from."""
    found = []
    for node in filter(_of_package, ast.walk(tree)):
        for alias in node.names:
            origins = (node.module, f"{node.module}.{alias.name}")
            found.append((f"{alias.name} as {alias.asname}", [name for name in origins if _is_hashed(name)]))
    return found


def _statements(tree: ast.Module) -> str:
    """The statements of a module as text, without docstrings and imports from the package; changes the tree."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body = node.body[1:]
        if isinstance(getattr(node, "body", None), list):
            node.body = [statement for statement in node.body if not _of_package(statement)]
    return ast.dump(tree)


def _of_package(node: ast.AST) -> bool:
    return isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "zsdist"


def _is_hashed(name: str) -> bool:
    return name not in APART and name != "zsdist" and _file(name) is not None


def _tree(name: str) -> ast.Module:
    return ast.parse(_file(name).read_text())


def _file(name: str) -> Path | None:
    place = _PACKAGE.joinpath(*name.split(".")[1:])
    files = (place.with_suffix(".py"), place / "__init__.py")
    return next((file for file in files if file.is_file()), None)


def _digest(texts: list[str]) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:DIGITS]
