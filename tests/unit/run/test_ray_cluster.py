"""Where Ray is told to put the process of a role, at the start and after its node has gone."""

from types import SimpleNamespace

import pytest
import ray

from zsdist.config import parse
from zsdist.run import placement, ray_cluster
from zsdist.run.placement import SPARE
from zsdist.run.program import RoleSpec
from zsdist.run.ray_cluster import NodeAwayError, Places

IDS = {name: f"{number:056x}" for number, name in enumerate(("head", "a", "b", "again"), 1)}
REPLAY, LEARNER, ACTOR = (RoleSpec(*who, 1) for who in (("replay", "0"), ("learner", "low"), ("actor", "0")))


class Cluster:
    """Nodes by name, with their free cores; tests let them go and come."""

    def __init__(self):
        self.free = {"head": 2.0, "a": 8.0, "b": 4.0}
        self.names = {name: name for name in IDS}
        self.memory = {"a": 2.0**35}

    def nodes(self):
        return [
            {
                "Alive": True,
                "Labels": {},
                "NodeID": IDS[key],
                "NodeName": self.names[key],
                "Resources": self.offered(key),
            }
            for key in self.free
        ]

    def offered(self, key):
        return {"CPU": self.free[key], "memory": self.memory.get(key, 2.0**33)}

    def left(self):
        return {IDS[key]: self.offered(key) for key in self.free}


@pytest.fixture
def cluster(monkeypatch):
    made = Cluster()
    monkeypatch.setattr(ray, "nodes", made.nodes)
    monkeypatch.setattr(ray, "get_runtime_context", lambda: SimpleNamespace(get_node_id=lambda: IDS["head"]))
    monkeypatch.setattr(ray_cluster, "available_resources_per_node", made.left)
    return made


def places(**cluster_settings):
    run = {"address": "head:6379", "cpus_per_role": 1.0, "standby": False}
    transport = {"endpoint": "tls/10.0.0.1:7447", "tls": "certificates"}
    others = {"learner": {"node": "others"}, "replay": {"node": "others"}} | cluster_settings
    config = parse({"run": run, "transport": transport, "replay": {"journals": ["/x"]}, "cluster": others})
    return Places(config, placement.plan(config, ray_cluster.nodes(), ray_cluster.here()))


def node(options):
    strategy = options.get("scheduling_strategy")
    return None if strategy is None else next(name for name, key in IDS.items() if key == strategy.node_id)


def test_a_shard_comes_back_to_the_node_with_its_journal_or_waits_for_it(cluster):
    chosen = places()
    assert [node(chosen.options(REPLAY)) for _ in range(2)] == ["a", "a"]
    free = cluster.free.pop("a")
    with pytest.raises(NodeAwayError, match="replay-0 has its journal on a, which is not in the cluster"):
        chosen.options(REPLAY)
    cluster.free["again"], cluster.names["again"] = free, "a"  # a node that comes back has another identity
    assert node(chosen.options(REPLAY)) == "again"


def test_a_learner_finds_another_node_and_queues_where_there_is_none(cluster):
    chosen = places()
    first = node(chosen.options(LEARNER))
    assert first in ("a", "b")
    del cluster.free[first]
    (other,) = {"a", "b"} - {first}
    assert node(chosen.options(LEARNER)) == other
    cluster.free[other] = 0.5
    options = chosen.options(LEARNER)
    assert node(options) is None and options["label_selector"] == {"ray.io/node-id": f"!{IDS['head']}"}
    assert f"it needs 1 core of Ray on another machine; {other} has 0.5 cores of Ray free" in chosen.lack(LEARNER)


def test_actors_are_left_to_ray_with_their_labels(cluster):
    options = places().options(ACTOR)
    assert options == {"num_cpus": 1.0}
    labelled = places(actor={"node": "others", "gpus": 0.0, "cpus": 0.5}).options(ACTOR)
    assert labelled == {"num_cpus": 0.5, "label_selector": {"ray.io/node-id": f"!{IDS['head']}"}}


def test_only_a_role_of_this_machine_that_reserves_as_much_is_replaced_by_the_spare(cluster):
    assert not places().spare_serves(LEARNER)
    cluster.free["head"] = 9.0
    here = {"node": "launcher"}
    assert places(learner=here).spare_serves(LEARNER)
    assert not places(learner={**here, "cpus": 2.0}).spare_serves(LEARNER)
    assert node(places().options(SPARE)) == "head"


def test_a_head_without_cores_is_asked_for_none(cluster):
    cluster.free["head"] = 0.0
    assert places().options(RoleSpec("scheduler", "0", 1))["num_cpus"] == 0.0
