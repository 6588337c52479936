"""What an episode depends on, as hashes: the code that drives it, and who drives."""

import ast
import hashlib
import json
from functools import cache
from pathlib import Path

import zsdist
from zsdist.dqn import network
from zsdist.evaluation.drivers import Sees
from zsdist.evaluation.entrants import Entrant
from zsdist.vision.identity import VisionIdentity
from zsdist.vision.visual_act import VisualAct

DIGITS = 16  # of a hash in hexadecimal
ROOT = "zsdist.evaluation.workers"  # all that drives an episode is imported from here
APART = ("zsdist.config", "zsdist.errors", "zsdist.workers")  # settings are hashed as values; the others drive nothing
_PACKAGE = Path(zsdist.__file__).parent


@cache
def code_sha256() -> str:
    """Hash of the code that determines an episode: simulator, vision, planning, agent and drivers.

    Of every module of the package that `ROOT` imports, directly or through others, the statements without comments and
    docstrings: what changes only words or layout changes no hash. What measures, reports, learns or distributes is not
    among them, nor are `APART`.
    """
    digest = hashlib.sha256()
    for name in sorted(modules(ROOT)):
        digest.update(f"{name}\n{_statements(ast.parse(_file(name).read_text()))}\n".encode())
    return digest.hexdigest()[:DIGITS]


def modules(root: str) -> set[str]:
    """Names of the package's modules that a module needs, itself included, without `APART`."""
    found, open_ = set(), [root]
    while open_:
        name = open_.pop()
        if name in found or name in APART or not name.startswith("zsdist.") or _file(name) is None:
            continue
        found.add(name)
        for node in ast.walk(ast.parse(_file(name).read_text())):
            if isinstance(node, ast.Import):
                open_ += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                open_ += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return found


def entrant_sha256(entrant: Entrant) -> str:
    """Hash of who drives: the baseline or variant, its settings, its networks, and what it sees by.

    Raises:
        WeightsError: it sees by vision weights that are missing or damaged.
    """
    settings = entrant.settings.model_dump(mode="json", include={"grid", "sim", "camera", "vision", "agent"})
    settings["vision"].pop("cache_bytes")
    sight = None
    if entrant.sees is Sees.CAMERA:
        model = VisualAct.load(entrant.settings.vision, entrant.settings.camera)
        sight = VisionIdentity.of(model, entrant.settings.vision.network).written()
    networks = {level: network.sha256(parameters) for level, parameters in (entrant.networks or {}).items()}
    told = [entrant.baseline, entrant.variant, entrant.shielded, settings, sight, networks]
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:DIGITS]


def _file(name: str) -> Path | None:
    place = _PACKAGE.joinpath(*name.split(".")[1:])
    files = (place.with_suffix(".py"), place / "__init__.py")
    return next((file for file in files if file.is_file()), None)


def _statements(tree: ast.Module) -> str:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body = node.body[1:]
    return ast.dump(tree)
