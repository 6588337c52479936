"""Reader of YAML that refuses a repeated key instead of silently dropping its first value."""

from typing import Any

import yaml


class DuplicateKeyError(yaml.YAMLError):
    """Mapping that has a key twice."""


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
        return super().construct_mapping(node, deep)


def load(text: str) -> Any:
    """Return the tree in a text of plain YAML.

    Raises:
        yaml.YAMLError: the text is not YAML, or a mapping has a key twice.
        ValueError: a date or number is impossible.
        RecursionError: it is nested too deeply.
    """
    return yaml.load(text, Loader=_Loader)
