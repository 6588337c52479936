"""Roles placed on paper: what a cluster lacks is said before anything starts, in terms of the settings that decide."""

import pytest

from zsdist.config import parse
from zsdist.errors import RunError
from zsdist.run import placement
from zsdist.run.placement import CPU, GPU, MEMORY, Node

GIB = 2**30


def node(name, cpus=0.0, *, free=None, labels=None, gpus=0.0, memory=8 * GIB):
    total = {amount: value for amount, value in ((CPU, cpus), (GPU, gpus), (MEMORY, memory)) if value}
    return Node(f"id-{name}", name, total, {**total, CPU: cpus if free is None else free}, labels or {})


def cluster(actors=2, shards=1, **settings):
    """Configuration of a run on a cluster whose roles reserve a core each, so that 6 live on the head by default."""
    run = {"address": "head:6379", "cpus_per_role": 1.0, "actors": actors}
    transport = {"endpoint": "tls/10.0.0.1:7447", "tls": "certificates"}
    replay = {"shards": shards, "journals": ["/var/lib/zsdist"]}
    return parse({"run": run, "transport": transport, "replay": replay, "cluster": settings})


def places(config, *nodes, **options):
    return {name: home.name for name, home in placement.plan(config, nodes, "id-head", **options).nodes.items()}


def refusal(config, *nodes, **options):
    with pytest.raises(RunError) as refused:
        placement.plan(config, nodes, "id-head", **options)
    assert "\n" not in str(refused.value)
    return str(refused.value)


BESIDES = {"hub-0", "scheduler-0", "spare-0"}
MOVED = {"learner": {"node": "others"}, "replay": {"node": "others"}}


def test_all_but_the_actors_live_on_the_launching_machine_by_default():
    assert places(cluster(), node("head", 6), node("a", 2)) == dict.fromkeys(
        BESIDES | {"replay-0", "learner-high", "learner-low"}, "head"
    )


def test_a_head_that_is_too_small_is_refused_though_the_cluster_has_the_cores():
    text = refusal(cluster(), node("head", 4), node("a", 6))
    assert "the roles that live on this machine ask for 6 cores of Ray (hub-0, " in text and "head has 4 cores" in text
    assert "cluster.learner.node=others and cluster.replay.node=others" in text


def test_a_head_without_cores_is_spared_by_all_that_may_live_elsewhere():
    head, workers = node("head"), (node("a", 4), node("b", 4))
    text = refusal(cluster(), head, *workers)
    assert "offers Ray no cores, and replay-0, learner-high, learner-low are to live on it" in text
    found = places(cluster(actors=5, **MOVED), head, *workers)
    assert {name for name, home in found.items() if home == "head"} == BESIDES
    assert "room for 5 of 6 actors" in refusal(cluster(actors=6, **MOVED), head, *workers)


def test_a_learner_goes_where_the_labels_and_the_gpu_are():
    config = cluster(learner={"node": "any", "labels": "rack=a", "gpus": 0.5})
    nodes = node("head", 6), node("a", 8, labels={"rack": "a"}, gpus=1), node("b", 8, labels={"rack": "b"}, gpus=4)
    found = places(config, *nodes)
    assert found["learner-high"] == found["learner-low"] == "a" and found["replay-0"] == "head"


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ({"node": "others", "labels": "rack=c"}, "with labels rack=c; of 2 nodes none is one; their labels are rack=a"),
        ({"node": "others", "gpus": 1}, "1 core of Ray and 1 GPU on another machine; of the 1 possible nodes none"),
        ({"node": "any", "memory_bytes": 9 * GIB}, "9216 MiB of memory on any machine; of the 2 possible nodes none"),
        ({"node": "any", "cpus": 20}, "20 cores of Ray on any machine"),
    ],
)
def test_a_role_that_fits_nowhere_is_named_with_what_it_needs_and_what_there_is(place, words):
    text = refusal(cluster(learner=place), node("head", 6), node("a", 6, labels={"rack": "a"}))
    assert "learner-low has no place: it needs 1 core" in text or "it needs 20 cores" in text
    assert words in text and "see cluster.learner" in text


def test_a_cluster_of_one_node_has_no_others():
    assert "the cluster has no node but this one" in refusal(cluster(**MOVED), node("head", 20))


def test_shards_are_spread_over_nodes_and_the_one_with_most_memory_comes_first():
    config = cluster(actors=4, shards=3, replay={"node": "others", "memory_bytes": 2 * GIB})
    nodes = [node(name, 9, memory=memory * GIB) for name, memory in (("a", 4), ("b", 64), ("c", 16))]
    found = places(config, node("head", 5), *nodes)
    assert [found[f"replay-{index}"] for index in range(3)] == ["b", "c", "a"]


def test_too_few_cores_for_the_actors_are_said_in_numbers():
    text = refusal(cluster(actors=16), node("head", 6), node("a", 8), node("b", 7))
    assert "the run asks for 22 cores of Ray, the cluster has 21 on 3 nodes, with room for 15 of 16 actors" in text
    assert places(cluster(actors=16), node("head", 6), node("a", 8), node("b", 8))


def test_cores_that_lie_idle_in_pieces_are_no_room():
    config = cluster(actors=2, actor={"cpus": 1.5})
    assert "room for 1 of 2 actors" in refusal(config, node("head", 7), node("a", 2), node("b", 1))


def test_what_others_have_reserved_counts_for_all_but_the_actors():
    head = node("head", 6, free=5)
    assert "head has 5 cores of Ray free" in refusal(cluster(), head, node("a", 6), free=True)
    assert places(cluster(), node("head", 6), node("a", 6, free=0), free=True)


def test_the_hub_of_a_rack_lives_on_a_node_of_the_rack():
    config = cluster(hubs=["tls/10.0.1.1:7447@rack=a", "tls/10.0.2.1:7447@rack=b"])
    nodes = node("head", 6), node("a", 2, labels={"rack": "a"}), node("b", 2, labels={"rack": "b"})
    found = places(config, *nodes)
    assert (found["hub-0"], found["hub-1"], found["hub-2"]) == ("head", "a", "b")
    assert "hub-2 has no place: it needs 1 core of Ray on any machine with labels rack=b" in refusal(config, *nodes[:2])


def test_actors_may_be_kept_away_from_the_launching_machine():
    config = cluster(actors=2, actor={"node": "others"})
    assert places(config, node("head", 8), node("a", 2))
    assert "room for 1 of 2 actors" in refusal(config, node("head", 8), node("a", 1))
