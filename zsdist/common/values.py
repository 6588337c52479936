"""Values of settings from their texts: the type of the setting decides, not the spelling of the text."""

import re
from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from zsdist.common import strict_yaml
from zsdist.common.places import Place
from zsdist.common.strict_yaml import Plain

NOTHING = ("", "~", "null", "Null", "NULL")  # without quotes, for a setting that may be None
_WHOLE = re.compile(r"[+-]?[0-9]+(_[0-9]+)*")
_REAL = re.compile(r"[+-]?([0-9]+(_[0-9]+)*\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_NOT_FINITE = re.compile(r"([+-]?)\.?(inf|infinity|nan)", re.IGNORECASE)
_TRUTH = dict.fromkeys(("true", "yes", "on", "y", "t", "1"), True)
_TRUTH |= dict.fromkeys(("false", "no", "off", "n", "f", "0"), False)
_ITEM = re.compile(r"""\s*("(?:[^"\\]|\\.)*"|'(?:[^']|'')*'|[^,]*?)\s*(?:,|$)""")


def typed(annotation: Any, value: Any) -> Any:
    """Return a value read from a file or an option as the type of its setting; pydantic checks the rest.

    Args:
        annotation: type of the setting.
        value: tree of texts; values that have another type already are left as they are.

    Raises:
        ValueError: the text is no value of this type; or a truth value was given for a number.
    """
    kind, inner = _kind(annotation)
    if isinstance(value, Plain) and value in NOTHING and NoneType in inner:
        return None
    if kind is tuple:
        items = [value] if isinstance(value, str | int | float) else value
        return [typed(inner[0], item) for item in items] if isinstance(items, list | tuple) else value
    if kind is int or kind is float:
        return number(value, whole=kind is int)
    if kind is bool and isinstance(value, str):
        if value.strip().lower() not in _TRUTH:
            raise ValueError("allowed is true or false")
        return _TRUTH[value.strip().lower()]
    if isinstance(kind, type) and issubclass(kind, BaseModel) and isinstance(value, Plain) and value in NOTHING:
        return {}  # a section with nothing in it
    return str(value) if isinstance(value, Plain) else value


def number(value: Any, *, whole: bool = False) -> Any:
    """Return the number that a text stands for; any value that is neither a text nor a truth value as it is.

    Whole numbers are decimal, with or without leading zeros. A number such as 1e3 is a whole one too.

    Raises:
        ValueError: the text stands for no number, or for none that is whole; or the value is a truth value.
    """
    allowed = "allowed is a whole number, such as 12" if whole else "allowed is a number, such as 0.5 or 1e-3"
    if isinstance(value, bool):
        raise ValueError(allowed)
    if not isinstance(value, str):
        return value
    text = value.strip()
    if whole and _WHOLE.fullmatch(text) and len(text) < 100:
        return int(text)
    if found := _NOT_FINITE.fullmatch(text):
        real = float("".join(found.groups()))
    elif _REAL.fullmatch(text):
        real = float(text)
    else:
        raise ValueError(allowed)
    if whole and not real.is_integer():
        raise ValueError(allowed)
    return int(real) if whole else real


def of_override(annotation: Any, text: str) -> Any:
    """Return the value in an override, as `typed` takes it: a text, a list of texts, or a tree for a section.

    Quotes around a text are taken off. Without them nothing in a text has a meaning, whatever YAML would make of it.

    Args:
        annotation: type of the setting; None: there is no such setting.
        text: text behind the equals sign.

    Raises:
        yaml.YAMLError, ValueError, RecursionError: a section's text is no YAML.
    """
    text = text.strip()
    kind, _ = _kind(annotation)
    if kind is tuple and text.startswith("[") != text.endswith("]"):
        raise ValueError("its brackets do not match")
    if kind is tuple and text.startswith("["):
        items, rest = [], text[1:-1].strip()
        while rest:
            found = _ITEM.match(rest)
            if found is None or not found.end():
                break
            items.append(_unquoted(found[1]))
            rest = rest[found.end() :]
        return items
    if text.startswith("{") and isinstance(kind, type) and issubclass(kind, BaseModel):
        return strict_yaml.load(text)
    return _unquoted(text)


def leaves(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the path and the type of every setting that is no section, such as `sim.step_s`, in order."""
    for name, field in model.model_fields.items():
        kind, _ = _kind(field.annotation)
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from leaves(kind, f"{prefix}{name}.")
        else:
            annotation = field.annotation
            yield prefix + name, Annotated[annotation, *field.metadata] if field.metadata else annotation


def find_type(model: type[BaseModel], key: str) -> Any:
    """Return the type of a setting or section by its path; None if there is none."""
    name, _, rest = key.partition(".")
    field = model.model_fields.get(name)
    if field is None or not rest:
        return None if field is None else field.annotation
    kind, _ = _kind(field.annotation)
    return find_type(kind, rest) if isinstance(kind, type) and issubclass(kind, BaseModel) else None


def find_place(annotation: Any) -> Place | None:
    """Return the mark of a setting that is a path or a list of paths; None for any other setting."""
    for part in (*getattr(annotation, "__metadata__", ()), *get_args(annotation)):
        if isinstance(part, Place):
            return part
        if part is not annotation and (found := find_place(part)) is not None:
            return found
    return None


def _kind(annotation: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return the class behind a type, and the types in its brackets; for `X | None` those of X, and NoneType."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kind(inner[0])
    if origin in (Union, UnionType):
        kind, _ = _kind(next(part for part in inner if part is not NoneType))
        return kind, inner
    if origin is Literal:
        return str, ()
    return (origin or annotation), inner


def _unquoted(text: str) -> str:
    """Return a text without quotes around it; `Plain` if it has none."""
    if len(text) > 1 and text[0] == text[-1] == "'" and "'" not in text[1:-1].replace("''", ""):
        return text[1:-1].replace("''", "'")
    if len(text) > 1 and text[0] == text[-1] == '"':
        try:
            return str(strict_yaml.load(text))
        except (strict_yaml.yaml.YAMLError, ValueError):
            return Plain(text)
    return Plain(text)
