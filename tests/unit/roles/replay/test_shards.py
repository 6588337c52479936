import pytest

from zsdist.config import parse
from zsdist.errors import ConfigError
from zsdist.roles.replay import shards
from zsdist.roles.replay.shards import ReplayShard


def config(count, actors):
    return parse({"replay": {"shards": count}, "run": {"actors": actors}})


@pytest.mark.parametrize(("count", "actors"), [(1, 1), (2, 2), (2, 5), (3, 7), (4, 4)])
def test_every_actor_has_one_shard_and_shares_follow_the_actors(count, actors):
    settings = config(count, actors)
    every = [ReplayShard.of(settings, index) for index in range(count)]
    for number in range(actors):
        assert sum(shard.owns(f"actor-{number}") for shard in every) == 1
    assert sum(shard.share for shard in every) == 1
    for shard in every:
        assert shard.share * actors == sum(shard.owns(f"actor-{number}") for number in range(actors))


def test_parts_add_up_to_the_whole_but_for_rounding():
    every = [ReplayShard.of(config(3, 7), index) for index in range(3)]
    assert abs(sum(shard.part(10_000) for shard in every) - 10_000) <= 1
    assert [shard.part(1) for shard in every] == [1, 1, 1]


def test_the_only_shard_owns_actors_of_any_name():
    assert ReplayShard.of(config(1, 1), 0).owns("anybody")
    assert not ReplayShard.of(config(2, 2), 0).owns("anybody")


def test_an_actor_that_joins_later_has_one_shard_too():
    every = [ReplayShard.of(config(3, 7), index) for index in range(3)]
    for name in ("actor-7", "actor-8", "actor-4095"):
        assert [shard.owns(name) for shard in every].count(True) == 1
    assert not any(shard.owns(name) for shard in every for name in ("actor-4096", "actor-x", "stranger"))


def test_the_first_shard_is_named_as_if_it_were_the_only_one():
    assert shards.state_names(config(1, 3)) == ["replay"]
    assert shards.state_names(config(3, 3)) == ["replay", "replay-1", "replay-2"]
    assert [ReplayShard.of(config(2, 2), index).name for index in range(2)] == ["replay", "replay-1"]


def test_a_shard_without_actors_is_refused():
    with pytest.raises(ConfigError, match=r"replay\.shards is 3; allowed is at most run\.actors, 2"):
        config(3, 2)
