"""Keys have the published form, and parsing returns the parts that made them."""

import pytest

from zsdist.errors import ProtocolError
from zsdist.types import Level
from zsdist.wire import keys

RUN = "default"
EXAMPLES = [
    (keys.push(RUN, Level.LOW, "a0", 3), "push/low/a0/3", {"level": "low", "actor": "a0", "epoch": "3"}),
    (keys.episodes(RUN, "a0", 3), "episodes/a0/3", {"actor": "a0", "epoch": "3"}),
    (keys.ack(RUN, "a0"), "ack/a0", {"actor": "a0"}),
    (keys.sample(RUN, Level.HIGH), "sample/high", {"level": "high"}),
    (keys.priority(RUN, Level.HIGH), "priority/high", {"level": "high"}),
    (keys.sample(RUN, Level.HIGH, 2), "sample/high/2", {"level": "high", "shard": "2"}),
    (keys.priority(RUN, Level.LOW, 12), "priority/low/12", {"level": "low", "shard": "12"}),
    (keys.weights(RUN, Level.LOW), "weights/low", {"level": "low"}),
    (keys.candidate(RUN, Level.LOW, "best"), "candidate/low/best", {"level": "low", "id": "best"}),
    (keys.evaluation(RUN, "a0"), "evaluation/a0", {"actor": "a0"}),
    (keys.control(RUN, "learner-low"), "control/learner-low", {"role": "learner-low"}),
    (keys.stats(RUN, "replay", "0"), "stats/replay/0", {"role": "replay", "id": "0"}),
    (keys.events(RUN), "events", {}),
    (keys.alive(RUN, "learner", "low"), "alive/learner/low", {"role": "learner", "id": "low"}),
    (keys.view(RUN, "actor-3", 2), "view/actor-3/2", {"actor": "actor-3", "car": "2"}),
    (keys.join(RUN, "actor-3"), "join/actor-3", {"actor": "actor-3"}),
]


@pytest.mark.parametrize(("key", "expected", "fields"), EXAMPLES)
def test_each_key_is_as_published_and_reads_back(key: str, expected: str, fields: dict[str, str]) -> None:
    assert key == f"zsdist/default/{expected}"
    assert keys.parse(key) == (RUN, expected.split("/")[0], fields)


def test_patterns_have_a_star_for_any_name() -> None:
    assert keys.push(RUN, Level.LOW, keys.ANY, keys.ANY) == "zsdist/default/push/low/*/*"
    assert keys.stats(keys.ANY, keys.ANY, keys.ANY) == "zsdist/*/stats/*/*"


@pytest.mark.parametrize(
    "key",
    [
        "",
        "zsdist",
        "zsdist/default",
        "other/default/events",
        "zsdist/default/unknown/a",
        "zsdist/default/ack",
        "zsdist/default/ack/a0/more",
        "zsdist/default/ack/",
        "zsdist/default/ack/*",
        "zsdist/default/sample/middle",
        "zsdist/default/sample/low/0",
        "zsdist/default/sample/low/x",
        "zsdist/default/sample/low/1/2",
        "zsdist/default/push/low/a0/x",
        "zsdist/default/push/low/a0/03",
        "zsdist/default/push/low/a0/-1",
        "zsdist/default/push/low/a0/\u0663",
        "zsdist/default/ack/" + "a" * 65,
    ],
)
def test_foreign_keys_are_not_parsed(key: str) -> None:
    assert keys.parse(key) is None


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: keys.ack("a/b", "a0"), "run is 'a/b'"),
        (lambda: keys.ack("", "a0"), "run is ''"),
        (lambda: keys.ack(RUN, "a b"), "actor is 'a b'"),
        (lambda: keys.ack(RUN, "**"), "actor is"),
        (lambda: keys.sample(RUN, "middle"), "level is 'middle'"),
        (lambda: keys.push(RUN, Level.LOW, "a0", -1), "epoch is '-1'"),
    ],
)
def test_names_that_cannot_stand_in_a_key_are_refused(make, message: str) -> None:
    with pytest.raises(ProtocolError, match=message.replace("*", r"\*")):
        make()
