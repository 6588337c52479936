"""Hashes of all that an episode depends on: the code that drives it, and the contender."""

import hashlib
import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from zsdist.common import code_hash, strict_yaml
from zsdist.dqn import network
from zsdist.errors import RunError
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.drivers import Observability
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.vision.visual_act import VisualAct

ROOT = "zsdist.evaluation.workers"  # imports everything that drives an episode
EQUIVALENT_CODE = Path(__file__).with_name("equivalent_code.yaml")
SECTIONS = ("grid", "sim", "camera", "vision", "agent")  # of the settings, on which an episode depends
_HASH = re.compile(rf"[0-9a-f]{{{code_hash.DIGITS}}}")
_ENTRY = {"commit", "hashes", "proof"}


def code_sha256() -> str:
    """Return the hash of the code that determines an episode: simulator, vision, planning, agent and drivers.

    Code that measures, reports, learns or distributes is not part of it. Settings are hashed as values instead.
    """
    return code_hash.sha256(ROOT)


def equivalent(code: str, file: Path = EQUIVALENT_CODE) -> frozenset[str]:
    """Return the code hashes whose episodes are bit-identical to those of `code`, itself included.

    Args:
        code: hash that `code_sha256` returned.
        file: YAML list of the versions of the code that were compared; a hash that is not in it equals only itself.

    Raises:
        RunError: the file cannot be read or is damaged.
    """
    return _equivalents(file).get(code, frozenset((code,)))


@cache
def _equivalents(file: Path) -> dict[str, frozenset[str]]:
    """Return for every hash in a file all hashes of its entry."""
    try:
        entries = strict_yaml.load(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise RunError(f"equivalent code cannot be read from {file}: {error.strerror or error}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise RunError(f"{file} is not valid YAML: {' '.join(str(error).split())}") from error
    if not isinstance(entries, list):
        raise RunError(f"{file} holds a {type(entries).__name__}; allowed is a list of entries")
    found: dict[str, frozenset[str]] = {}
    for number, entry in enumerate(entries, 1):
        hashes = _hashes(entry, f"{file}, entry {number}")
        if listed := sorted(hashes & found.keys()):
            raise RunError(f"{file}, entry {number}: hash {listed[0]} is in an earlier entry too; allowed is one")
        found |= dict.fromkeys(hashes, hashes)
    return found


def _hashes(entry: Any, place: str) -> frozenset[str]:
    """Return the hashes of an entry; raise `RunError` if it is damaged."""
    if not isinstance(entry, dict) or entry.keys() != _ENTRY:
        raise RunError(f"{place} is {entry!r}; allowed is a mapping with {', '.join(sorted(_ENTRY))}")
    for key in ("commit", "proof"):
        if not isinstance(entry[key], str) or len(entry[key].strip().splitlines()) != 1:
            raise RunError(f"{place}: {key} is {entry[key]!r}; allowed is a text in one line")
    hashes = entry["hashes"]
    if not isinstance(hashes, list) or not hashes:
        raise RunError(f"{place}: hashes is {hashes!r}; allowed is a list of one or more")
    for item in hashes:
        if not isinstance(item, str) or not _HASH.fullmatch(item):
            raise RunError(f"{place}: hash is {item!r}; allowed are {code_hash.DIGITS} hexadecimal digits in quotes")
    return frozenset(hashes)


def contender_sha256(contender: Contender) -> str:
    """Return the hash of a contender: baseline or variant, settings, networks, and the vision model it uses.

    Raises:
        WeightsError: the vision weights are missing or damaged.
    """
    settings = contender.settings.model_dump(mode="json", include=set(SECTIONS))
    settings["vision"].pop("cache_bytes")
    perception = None
    if contender.observability is Observability.CAMERA:
        model = VisualAct.load(contender.settings.vision, contender.settings.camera)
        perception = VisionIdentity.of(model, contender.settings.vision.network).to_json()
    networks = {level: network.sha256(parameters) for level, parameters in (contender.networks or {}).items()}
    parts = [contender.baseline, contender.variant, contender.shielded, settings, perception, networks]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[: code_hash.DIGITS]
