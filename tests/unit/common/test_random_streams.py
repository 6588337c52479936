import ast
import re
from pathlib import Path

import numpy as np
import pytest

import zsdist
from zsdist.common import random_streams

PACKAGE = Path(zsdist.__file__).parent


@pytest.mark.parametrize(
    ("stream", "numbers"),
    [
        (random_streams.initial_weights(5), 5),
        (random_streams.reflected_rows(5), [5, 1]),
        (random_streams.replay_sampling(5, True, 2), [5, 0, 2]),
        (random_streams.replay_sampling(5, False, 2), [5, 1, 2]),
        (np.random.default_rng(random_streams.exploration(5, 7)), [5, 7]),
        (random_streams.shielded_episodes(5, 7), [5, 7, 1]),
        (random_streams.training_scene(5, 7), [5, 7, 2]),
        (np.random.default_rng(random_streams.candidate_drive(5, 3, 7)), [5, 3, 7]),
        (random_streams.evaluated_episode(5, 7), [5, 7]),
        (random_streams.scene(3, 5), [3, 5]),
        (random_streams.labelled_pictures(5, "test"), [5, *b"test"]),
        (random_streams.masked_or_captioned_pictures(5, "test"), [5, 4, *b"test"]),
        (random_streams.check_set(5, 7), [5, 4, 7]),
        (random_streams.check_approach(5, 7), [5, 5, 7]),
    ],
)
def test_a_stream_is_seeded_by_the_numbers_of_the_table(stream, numbers):
    assert (stream.integers(2**63, size=4) == np.random.default_rng(numbers).integers(2**63, size=4)).all()


def test_the_table_lists_every_stream_of_the_module():
    functions = {
        node.name
        for node in ast.parse(Path(random_streams.__file__).read_text()).body
        if isinstance(node, ast.FunctionDef)
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
