"""The list of messages: every message in it exists in the code, and every error of a user is in it."""

import ast
import re
from functools import cache
from pathlib import Path

import zsdist

PACKAGE = Path(zsdist.__file__).parent
PAGE = (PACKAGE.parent / "docs" / "troubleshooting.md").read_text()
USER_ERRORS = {
    "ConfigError",
    "SceneError",
    "TransportError",
    "WeightsError",
    "RunError",
    "DamagedError",
    "BundleError",
    "DataError",
    "CacheError",
    "SimulationError",
}
VALUE = "\0"
PASSED_ON = 5  # letters; a message with so few of its own passes on another one


def shape(node: ast.expr) -> str | None:
    """Return a text of the code with a mark for each value in it; None for anything else."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(part.value if isinstance(part, ast.Constant) else VALUE for part in node.values)
    return None


@cache
def trees() -> list[ast.Module]:
    return [ast.parse(path.read_text()) for path in sorted(PACKAGE.rglob("*.py"))]


def texts() -> set[str]:
    """Return all texts of the code."""
    return {text for tree in trees() for node in ast.walk(tree) if isinstance(node, ast.expr) and (text := shape(node))}


def user_errors() -> set[str]:
    """Return the messages of all errors that users can cause."""
    found = set()
    for tree in trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and node.exc.args:
                name, text = ast.unparse(node.exc.func).rpartition(".")[2], shape(node.exc.args[0])
                if name in USER_ERRORS and text is not None and len(re.findall("[a-z]", text)) > PASSED_ON:
                    found.add(text)
    return found


def sections() -> list[list[str]]:
    """Return the messages of each table, as they are written there."""
    parts = PAGE.split("\n## ")[1:]
    return [re.findall(r"^\| `([^`]+)` \|", part, re.MULTILINE) for part in parts]


def pattern(message: str) -> re.Pattern[str]:
    """Return the expression that finds the beginning of a message of the code."""
    return re.compile(".*".join(re.escape(part) for part in message.split("...")), re.DOTALL)


def test_every_message_in_the_list_exists_in_the_code():
    known = texts()
    listed = [message for section in sections() for message in section]
    assert len(listed) > 100
    stale = []
    for message in listed:
        parts, whole = message.split("..."), pattern(message)
        likely = (text for text in known if all(part in text for part in parts))
        if not any(whole.search(text) for text in likely):
            stale.append(message)
    assert stale == []


def test_every_error_of_a_user_is_in_the_list():
    patterns = [pattern(message) for message in sections()[0]]
    missing = [text for text in user_errors() if not any(one.match(text) for one in patterns)]
    assert sorted(text.replace(VALUE, "...") for text in missing) == []


def test_messages_are_in_alphabetical_order_and_none_is_there_twice():
    for section in sections():
        assert section == sorted(set(section), key=str.lower)


def test_every_row_says_why_and_what_to_do():
    rows = [line for line in PAGE.splitlines() if line.startswith("| `")]
    assert [row for row in rows if len([cell for cell in row.strip("|").split(" | ") if cell.strip()]) != 3] == []


def test_the_reader_of_messages_notices_a_stale_and_a_new_one():
    assert pattern("run ... has gone").match(f"run {VALUE} has gone away")
    assert not pattern("run ... has gone").match(f"run {VALUE} went")
