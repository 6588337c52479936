"""Reader of YAML whose values are all text, so that whoever uses a value decides its type, and not its spelling.

YAML 1.1 takes 010 for 8, 12:30 for 750, `no` for false and 2026-11-30 for a date. Here each stays as it is written;
`zsdist.common.values` makes numbers of them. A repeated key is refused instead of silently dropping its first value.
"""

import re
from pathlib import Path
from typing import Any

import yaml

from zsdist.errors import ConfigError


class DuplicateKeyError(yaml.YAMLError):
    """Mapping that has a key twice."""


class Plain(str):
    """Text that was written without quotes: it may mean nothing at all (`values.NOTHING`), and shows as written."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self) if self.strip() else super().__repr__()


class _Loader(yaml.SafeLoader):
    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            if isinstance(key_node, yaml.ScalarNode):
                if key_node.value in seen:
                    raise DuplicateKeyError(
                        f"line {key_node.start_mark.line + 1}: key {key_node.value!r} appears twice"
                    )
                seen.add(key_node.value)
        mapping = super().construct_mapping(node, deep)
        return {str(key) if isinstance(key, Plain) else key: value for key, value in mapping.items()}

    def construct_text(self, node: yaml.ScalarNode) -> str:
        """Return a scalar as it is written."""
        return Plain(node.value) if node.style is None else str(node.value)


_Loader.yaml_implicit_resolvers = {"<": [("tag:yaml.org,2002:merge", re.compile("^<<$"))]}
for tag in ("str", "int", "float", "bool", "timestamp"):  # a tag does not change how a value is spelt
    _Loader.add_constructor(f"tag:yaml.org,2002:{tag}", _Loader.construct_text)


def load(text: str) -> Any:
    """Return the tree in a text of YAML: dictionaries and lists of texts; None for an empty text.

    Raises:
        yaml.YAMLError: the text is not YAML, or a mapping has a key twice.
        ValueError: a value with a tag, such as `!!int`, is impossible.
        RecursionError: it is nested too deeply.
    """
    return yaml.load(text, Loader=_Loader)


def read(file: Path, what: str) -> Any:
    """Return the tree in a file of YAML, as `load`.

    Args:
        file: file to read.
        what: what the file is, for errors, such as `sweep file`.

    Raises:
        ConfigError: it cannot be read, or is not such YAML.
    """
    try:
        return load(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{what} {file}: {error.strerror or error}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: also a file that is not UTF-8
        raise ConfigError(f"{what} {file} is not valid YAML: {' '.join(str(error).split())}") from error
