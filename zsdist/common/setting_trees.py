"""Trees of unchecked settings: nested dictionaries from a YAML file, and overrides that change them."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel

from zsdist.common import presets, strict_yaml, values
from zsdist.common.places import Place
from zsdist.errors import ConfigError


def read(path: Path) -> dict[str, Any]:
    """Return the unchecked settings of a YAML file over those of its base, if it names one."""
    tree = _read_file(path)
    base = tree.pop("base", None)
    if base is None or base in values.NOTHING:
        return tree
    base_tree = _read_file(presets.find(str(base)) or path.parent / str(base))
    if "base" in base_tree:
        raise ConfigError(f"configuration file {path}: its base {base} has a base too; allowed is one without")
    merged: dict[str, Any] = _overlay(base_tree, tree)
    return merged


def _read_file(path: Path) -> dict[str, Any]:
    """Return the unchecked settings of a YAML file."""
    if os.path.isdir(path):
        raise ConfigError(f"configuration file {path} is a folder; allowed is a file, such as its config.yaml")
    try:
        tree = strict_yaml.read(path, "configuration file")
    except ConfigError as error:
        if not isinstance(error.__cause__, FileNotFoundError):
            raise
        raise ConfigError(f"{error}; allowed are a file, and the presets {', '.join(presets.names())}") from error
    if tree is None:
        return {}  # an empty file
    if not isinstance(tree, dict):
        raise ConfigError(f"configuration file {path} holds a {type(tree).__name__}; allowed is a mapping of settings")
    return tree


def _overlay(base: Any, changes: Any) -> Any:
    """Return a tree of settings with changes applied: sections are merged, values are replaced."""
    if not (isinstance(base, dict) and isinstance(changes, dict)):
        return changes
    return base | {key: _overlay(base.get(key), value) for key, value in changes.items()}


def apply(tree: dict[str, Any], override: str, model: type[BaseModel], short_forms: Mapping[str, str]) -> None:
    """Set the value of an override `key.path=value` in a tree of settings.

    Args:
        tree: tree that is changed.
        override: text of the override.
        model: settings; its types decide what the text means.
        short_forms: settings that the name of their section stands for.

    Raises:
        ConfigError: it has no such form, or a section's value is no YAML.
    """
    path, equals, text = override.partition("=")
    path = path.strip()
    if not equals or not path:
        raise ConfigError(f"--set {override!r} is not of the form key.path=value")
    if path in short_forms and not text.strip().startswith("{"):
        path = short_forms[path]
    try:
        value = values.of_override(values.find_type(model, path), text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ConfigError(f"--set {path}: value {text[:200]!r} is not valid YAML") from error
    for name, whole in short_forms.items():
        if name in tree and not isinstance(tree[name], dict):
            tree[name] = {whole.rpartition(".")[2]: tree[name]}
    *sections, leaf = path.split(".")
    node = tree
    for section in sections:
        node = node.setdefault(section, {})
        if not isinstance(node, dict):
            raise ConfigError(f"--set {path}: {section!r} is a value, not a section")
    node[leaf] = _overlay(node.get(leaf), value)


def flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the values of a tree by their paths."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        found |= flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return found


def find_places(tree: Mapping[str, Any], model: type[BaseModel]) -> Iterator[tuple[str, Place, str]]:
    """Yield path of the setting, mark and text of all paths and names in a tree."""
    found = flat(tree)
    for key, annotation in values.leaves(model):
        if (place := values.find_place(annotation)) is not None:
            value = values.typed(annotation, found.get(key))
            for text in value if isinstance(value, list) else [value]:
                if isinstance(text, str):
                    yield key, place, text
