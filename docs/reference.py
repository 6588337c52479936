"""Reference pages of the documentation site: settings from their models, commands from their parsers, Python."""

import argparse
import html
import importlib
import inspect
import io
import json
import re
import tokenize
from collections.abc import Iterator
from enum import Enum
from types import NoneType
from typing import Any, get_args

from pydantic import BaseModel, TypeAdapter

from zsdist import __main__ as script
from zsdist.common import values
from zsdist.config import Config

NAMES = (  # what programs use, by the headings of the page
    ("Policies", ("zsdist.policy.load_policy", "zsdist.policy.DrivingPolicy")),
    ("The environment", ("zsdist.sim.env.CarNavigation",)),
    (
        "Scenes",
        (
            "zsdist.sim.scenes.families.draw",
            "zsdist.sim.scenes.families.generate",
            "zsdist.sim.scenes.scene.read",
            "zsdist.sim.scenes.scene.read_folder",
            "zsdist.sim.scenes.scene.write",
            "zsdist.sim.scenes.scene.Scene",
            "zsdist.sim.scenes.scene.Start",
            "zsdist.sim.scenes.scene.Obstacle",
        ),
    ),
    (
        "Bundles",
        ("zsdist.runtime.bundle.Bundle", "zsdist.runtime.runner.BundleRunner", "zsdist.runtime.runner.RunnerDecision"),
    ),
    ("Recorded sets", ("zsdist.recording.episode.read_episode", "zsdist.recording.episode.RecordedEpisode")),
    ("Poses, actions, errors", ("zsdist.types.Pose", "zsdist.types.Action", "zsdist.errors.ZsdistError")),
)
SHORT = {"zsdist.policy.load_policy": "zsdist.load_policy"}  # names under which programs know them
_SECTION = re.compile(r"(Args|Attributes|Raises|Returns|Yields|Observation, a dictionary):")
_ENTRY = re.compile(r"`?([*\w.]+)`?(?: \([^)]*\))?: (.*)")
_SIGNS = re.compile(r"[|*_`\[\]\\]")
GENERATED = "*This page is made from the code.*"


def settings() -> str:
    """Return the page of all settings, by section."""
    lines = [
        "# Settings",
        "",
        "Settings come from `--config`, a preset or a YAML file, and from `--set KEY.PATH=VALUE`; the later overrides "
        f"the earlier ([how values are written](../usage.md#configuration)). {GENERATED}",
    ]
    types = dict(values.leaves(Config))
    for key, model in _sections(Config, ""):
        fields = {name: field for name, field in model.model_fields.items() if not _is_section(field.annotation)}
        if not fields:
            continue
        lines += ["", f"## {key or 'The run as a whole'}", "", inspect.getdoc(model) or "", ""]
        lines += ["| setting | default | allowed | meaning |", "|---|---|---|---|"]
        default, meanings = _default(key), comments(model)
        for name in fields:
            path = f"{key}.{name}".lstrip(".")
            allowed = _allowed(types[path])
            shown = _code(json.dumps(_plain(getattr(default, name)), ensure_ascii=False).strip('"') or '""')
            row = (
                f'<span id="{path}"></span>{_code(path)}',
                shown,
                allowed,
                _text(meanings.get(name, "").replace("None", "`null`")),
            )
            lines.append(f"| {' | '.join(row)} |")
    return "\n".join(lines) + "\n"


def comments(model: type[BaseModel]) -> dict[str, str]:
    """Return the comments behind the fields of a model, those that it inherits included."""
    found: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if not issubclass(kind, BaseModel) or kind.__module__.startswith("pydantic"):
            continue
        name = None
        for token in tokenize.generate_tokens(io.StringIO(inspect.getsource(kind)).readline):
            if token.type == tokenize.NAME and token.start[1] == 4 and token.string in kind.model_fields:
                name = token.string
            elif token.type == tokenize.COMMENT and name is not None:
                found[name] = token.string.removeprefix("#").strip()
            elif token.type == tokenize.NEWLINE:
                name = None
    return found


def commands() -> str:
    """Return the page of all commands and their options."""
    lines = [
        "# Commands",
        "",
        "`zsdist COMMAND` is `python -m zsdist.COMMAND`. Every command takes `--help`, and `--debug`",
    ]
    lines += [
        f"for the traceback of an error. [What signals and statuses mean](../usage.md#stopping-a-command). {GENERATED}"
    ]
    for name, line in script.describe_commands().items():
        parser = importlib.import_module(f"zsdist.{name}").make_parser()
        parser.prog = f"zsdist {name}"
        lines += ["", f"## zsdist {name}", "", f"{line[:1].upper()}{line[1:]}"]
        lines += _options(parser)
    return "\n".join(lines) + "\n"


def python() -> str:
    """Return the page of what programs use."""
    lines = [
        "# Python",
        "",
        f"What programs use; all else may change. {GENERATED} [The environment](../environment.md) has",
    ]
    lines += ["tables of spaces, rewards and options, and examples."]
    for heading, names in NAMES:
        lines += ["", f"## {heading}"]
        for name in names:
            module, _, attribute = name.rpartition(".")
            thing = getattr(importlib.import_module(module), attribute)
            home = module.rpartition(".")[2]
            short = SHORT.get(name) or (attribute if inspect.isclass(thing) else f"{home}.{attribute}")
            lines += _described(thing, short, 3, _import(name, short))
            if inspect.isclass(thing):
                for member, value in vars(thing).items():
                    if not member.startswith("_") and _is_documented(value):
                        lines += _described(getattr(thing, member, value), f"{attribute}.{member}", 4)
    return "\n".join(lines) + "\n"


def _sections(model: type[BaseModel], key: str) -> Iterator[tuple[str, type[BaseModel]]]:
    yield key, model
    for name, field in model.model_fields.items():
        if _is_section(field.annotation):
            yield from _sections(field.annotation, f"{key}.{name}".lstrip("."))


def _is_section(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _default(key: str) -> Any:
    found: Any = Config()
    for part in filter(None, key.split(".")):
        found = getattr(found, part)
    return found


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _allowed(annotation: Any) -> str:
    """Return what a setting may be, in words."""
    place = values.find_place(annotation)
    words = _of_schema(TypeAdapter(annotation).json_schema())
    if place is not None:
        what = "path" if not place.names else "name or path"
        words = words.replace("text", what).replace("texts", f"{what}s")
    optional = NoneType in get_args(annotation) and "null" not in words
    return _text(f"{words}, or null" if optional else words)


def _of_schema(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(_of_schema(each) for each in schema["anyOf"])
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    kind = schema.get("type")
    if kind == "array":
        least = ", at least one" if schema.get("minItems") else ""
        return f"list: {_of_schema(schema['items'])}{least}"
    if kind in ("integer", "number"):
        what = "whole number" if kind == "integer" else "number"
        return f"{what}{_range(schema)}"
    if "pattern" in schema:
        return f"text of the form `{schema['pattern']}`"
    return {"string": "text", "boolean": "`true`, `false`", "null": "`null`"}[str(kind)]


def _range(schema: dict[str, Any]) -> str:
    least, most = schema.get("minimum"), schema.get("maximum")
    above, below = schema.get("exclusiveMinimum"), schema.get("exclusiveMaximum")
    if least is not None and most is not None:
        return f", {_number(least)} to {_number(most)}"
    parts = [f"at least {_number(least)}"] if least is not None else []
    parts += [f"above {_number(above)}"] if above is not None else []
    parts += [f"at most {_number(most)}"] if most is not None else []
    parts += [f"below {_number(below)}"] if below is not None else []
    return f", {', '.join(parts)}" if parts else ""


def _number(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) or abs(value) < 1000 else f"{value:,.0f}"


def _options(parser: argparse.ArgumentParser) -> list[str]:
    """Return usage and options of a parser, and those of its orders."""
    usage = " ".join(parser.format_usage().split()).removeprefix("usage: ")
    usage = usage.replace(" [-h]", "").replace(" [--debug]", "")  # said once for all commands
    lines = ["", f"```text\n{_folded(usage)}\n```", "", "| option | meaning |", "|---|---|"]
    orders = None
    formatter = argparse.HelpFormatter(parser.prog)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            orders = action
        elif not isinstance(action, argparse._HelpAction) and action.dest != "debug":
            name = formatter._format_action_invocation(action)
            lines.append(f"| {_code(name)} | {_text(formatter._expand_help(action) if action.help else '')} |")
    if orders is not None:
        lines = lines if len(lines) > 5 else lines[:2]  # without an empty table
        helps = {choice.dest: choice.help for choice in orders._choices_actions}
        for name, each in orders.choices.items():
            each.prog = f"{parser.prog} {name}"
            what = helps.get(name) or ""
            lines += ["", f"### {parser.prog} {name}", "", f"{what[:1].upper()}{what[1:]}.", *_options(each)]
    return lines


def _folded(usage: str) -> str:
    """Return a usage in lines of at most 100 characters, broken between options."""
    words = re.findall(r"\[[^\]]*\](?:\S*)|\S+", usage)
    lines = [words[0]]
    for word in words[1:]:
        if len(lines[-1]) + len(word) > 98:
            lines.append("   ")
        lines[-1] += f" {word}"
    return "\n".join(lines)


def _is_documented(value: Any) -> bool:
    function = getattr(value, "__func__", None) or getattr(value, "fget", None) or value
    return inspect.isfunction(function) and bool(function.__doc__)


def _import(name: str, short: str) -> str:
    """Return the line that makes a name known under its short form."""
    if short.startswith("zsdist."):
        return "import zsdist"
    return f"from {name.removesuffix(f'.{short}')} import {short.partition('.')[0]}"


def _described(thing: Any, name: str, level: int, imported: str = "") -> list[str]:
    """Return heading, signature and docstring of a function, a class or a property."""
    lines = ["", f"{'#' * level} {name}", ""]
    doc = inspect.getdoc(thing) or ""
    if inspect.isclass(thing) or inspect.isfunction(thing) or inspect.ismethod(thing):
        before = f"{imported}\n\n" if imported else ""
        lines += [f"```python\n{before}{_signature(thing, name)}\n```", ""]
    return [*lines, *_docstring(doc)]


def _signature(thing: Any, name: str) -> str:
    if inspect.isclass(thing) and issubclass(thing, Enum):
        return "\n".join(f"{name}.{member.name} = {member.value!r}" for member in thing)
    try:
        found = inspect.signature(thing)
    except ValueError:  # of an enumeration or an exception
        return name
    parameters = [str(each) for each in found.parameters.values() if each.name != "self"]
    returned = found.return_annotation
    end = "" if returned is inspect.Signature.empty or inspect.isclass(thing) else f" -> {_type(returned)}"
    parameters = [
        re.sub(r"\b(?:zsdist|numpy|pathlib|collections|typing)(?:\.\w+)*\.(?=\w)", "", each) for each in parameters
    ]
    line = f"{name}({', '.join(parameters)}){end}"
    return line if len(line) <= 88 else f"{name}(\n" + "".join(f"    {each},\n" for each in parameters) + f"){end}"


def _type(annotation: Any) -> str:
    return re.sub(r"\b(?:\w+\.)+(?=\w)", "", inspect.formatannotation(annotation)).strip("'\"")


def _docstring(text: str) -> list[str]:
    """Return a docstring of Google's style as Markdown."""
    lines: list[str] = []
    inside = False
    for line in text.splitlines():
        if (heading := _SECTION.fullmatch(line)) is not None:
            inside = True
            lines += ["" for _ in lines[-1:] if lines[-1]] + [f"**{heading.group(1)}**", ""]
        elif inside and line.startswith("        ") and lines[-1]:
            lines[-1] += f" {line.strip()}"
        elif inside and line.startswith("    "):
            entry = _ENTRY.fullmatch(line.strip())
            lines.append(f"- `{entry.group(1)}`: {entry.group(2)}" if entry else f"- {line.strip()}")
        else:
            inside = inside and not line.strip()
            lines.append(line)
    return lines


def _code(text: str) -> str:
    """Return code for a cell of a table, in which Markdown finds no signs of its own."""
    escaped = _SIGNS.sub(lambda match: f"&#{ord(match.group())};", html.escape(text, quote=False))
    return f"<code>{escaped}</code>"


def _text(text: str) -> str:
    """Return plain words for a cell of a table; only what stands between grave accents is code."""
    parts = re.split(r"`([^`]*)`", " ".join(text.split()))
    return "".join(_code(part) if i % 2 else re.sub(r"([*_|<>\[\]])", r"\\\1", part) for i, part in enumerate(parts))
