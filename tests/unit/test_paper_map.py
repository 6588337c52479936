"""Each equation of the paper has one home in the package and a test that names it."""

import ast
import re
from collections import defaultdict
from pathlib import Path

import zsdist

PACKAGE = Path(zsdist.__file__).parent
TESTS = Path(__file__).parents[1]
BUILT = set(range(1, 24))  # equations that must have a home


def homes() -> dict[int, list[str]]:
    """Return the docstrings that carry the mark of an equation, by its number."""
    found = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                text = ast.get_docstring(node) or ""
                for number in {int(digits) for digits in re.findall(r"Eq\. \((\d+)\)", text)}:
                    found[number].append(f"{path.relative_to(PACKAGE)}:{getattr(node, 'name', 'module')}")
    return dict(found)


def equations_with_a_test() -> set[int]:
    """Return the numbers of the equations that a test is named after."""
    numbers = set()
    for path in TESTS.rglob("test_*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef) and (match := re.match(r"test_eq(\d\d)_", node.name)):
                numbers.add(int(match[1]))
    return numbers


def test_no_equation_has_two_homes():
    assert {number: places for number, places in homes().items() if len(places) > 1} == {}


def test_every_equation_that_is_built_has_a_home():
    assert sorted(BUILT - set(homes())) == []


def test_every_equation_with_a_home_has_a_test_and_every_such_test_a_home():
    assert sorted(homes()) == sorted(equations_with_a_test())


def test_marks_are_numbers_of_the_paper():
    assert set(homes()) <= set(range(1, 24))
