"""The package's own code as a hash: what results depend on it changes with it, and with nothing else."""

import ast
import hashlib
from functools import cache
from pathlib import Path

import zsdist

DIGITS = 16  # of a hash in hexadecimal
APART = ("zsdist.config", "zsdist.errors", "zsdist.workers")  # settings are hashed as values; the others do nothing
_PACKAGE = Path(zsdist.__file__).parent


@cache
def sha256(*roots: str) -> str:
    """Hash of the modules `roots` and of every module of the package that they import, directly or through others.

    It is of their statements without comments and docstrings: what changes only words or layout changes no hash.
    """
    digest = hashlib.sha256()
    for name, tree in sorted(_trees(*roots).items()):
        digest.update(f"{name}\n{_statements(tree)}\n".encode())
    return digest.hexdigest()[:DIGITS]


def modules(*roots: str) -> set[str]:
    """Names of the package's modules that `roots` need, themselves included, without `APART`."""
    return set(_trees(*roots))


def _trees(*roots: str) -> dict[str, ast.Module]:
    found, open_ = {}, list(roots)
    while open_:
        name = open_.pop()
        if name in found or name in APART or not name.startswith("zsdist.") or _file(name) is None:
            continue
        found[name] = ast.parse(_file(name).read_text())
        for node in ast.walk(found[name]):
            if isinstance(node, ast.Import):
                open_ += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                open_ += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return found


def _file(name: str) -> Path | None:
    place = _PACKAGE.joinpath(*name.split(".")[1:])
    files = (place.with_suffix(".py"), place / "__init__.py")
    return next((file for file in files if file.is_file()), None)


def _statements(tree: ast.Module) -> str:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body = node.body[1:]
    return ast.dump(tree)
