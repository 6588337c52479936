import ast
import inspect
import itertools
import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import zsdist
from zsdist.common import random_streams
from zsdist.sim.scenes import families

PACKAGE = Path(zsdist.__file__).parent


def streams(*numbers):
    """Return every stream that can be made of the first of some numbers, by its name and what it was made of."""
    made = {}
    for name, stream in inspect.getmembers(random_streams, inspect.isfunction):
        if not name.startswith("_"):
            kinds = [parameter.annotation for parameter in inspect.signature(stream).parameters.values()]
            values = ["test" if kind is str else kind(number) for kind, number in zip(kinds, numbers, strict=False)]
            made[name, *values] = np.random.default_rng(stream(*values))
    return made


@pytest.mark.parametrize("seed", [0, 1, 5, 2**31 - 1])
def test_no_two_streams_draw_the_same(seed):
    subjects = itertools.product((0, 1, 2, 4, 2**32, 2**32 + 1), repeat=2)
    made = {key: stream for subject in subjects for key, stream in streams(seed, *subject).items()}
    drawn = Counter(tuple(stream.integers(2**63, size=2)) for stream in made.values())
    assert len(made) > 100 and set(drawn.values()) == {1}


def test_numbers_beyond_a_word_have_streams_of_their_own():
    made = [random_streams.evaluated_episode(*numbers) for numbers in ((5, 1), (5 + 2**32, 0), (5, 2**32), (5, 0))]
    assert len({int(stream.integers(2**63)) for stream in made}) == len(made)


def test_each_stream_has_the_tag_of_the_table_and_no_two_have_one():
    rows = dict(re.findall(r"^\| `(\w+)` \| (\d{4}|none) \|", random_streams.__doc__, re.MULTILINE))
    assert rows.pop("scene") == "none" and len(families.FAMILIES) < min(map(int, rows.values()))
    assert len(set(rows.values())) == len(rows)
    for (name, seed, *_), stream in streams(7, 1, 2).items():
        if name in rows:
            assert list(stream.bit_generator.seed_seq.entropy[:3]) == [int(rows[name]), seed, 0]


def test_scenes_are_drawn_as_ever():
    assert random_streams.scene(3, 5).integers(2**63) == np.random.default_rng([3, 5]).integers(2**63)


def test_the_table_lists_every_stream_of_the_module():
    functions = {
        node.name
        for node in ast.parse(Path(random_streams.__file__).read_text()).body
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_")
    }
    assert set(re.findall(r"^\| `(\w+)` \|", random_streams.__doc__, re.MULTILINE)) == functions


def test_seeds_become_generators_in_the_table_alone():
    """Generators made elsewhere come only from a constant, a hash, or the seed of a task."""
    allowed = re.compile(r"default_rng\((\d+|task\.seed|int\(scene\.hash\(\), 16\))\)")
    strangers = [
        f"{path.relative_to(PACKAGE)}: {line.strip()}"
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.name != "random_streams.py"
        for line in path.read_text().splitlines()
        if "default_rng(" in line and not allowed.search(line)
    ]
    assert strangers == []
