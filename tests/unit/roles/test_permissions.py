"""The access list checked against the key space; tests/integration/test_access.py checks it over real sockets."""

import pytest

from zsdist.roles import permissions
from zsdist.transport import access as transport_access
from zsdist.transport.memory import matches
from zsdist.wire import keys

GRANTS = {grant.name: grant for grant in permissions.access_list(3)}


def covers(patterns, key):
    return any(matches(pattern, key) for pattern in patterns)


def test_each_actor_may_push_under_its_own_name_only():
    for mine in range(3):
        for other in range(3):
            key = keys.push("run", "low", permissions.actor_name(other), 7)
            assert covers(GRANTS[permissions.actor_name(mine)].publish, key) == (mine == other)


@pytest.mark.parametrize("name", ["hub", "monitor", "actor-0", "actor-2"])
def test_watchers_ask_actors_for_their_cars_and_neither_has_weights_orders_or_batches(name):
    grant = GRANTS[name]
    assert grant.serve == ((keys.view(keys.ANY, name, keys.ANY),) if name.startswith("actor-") else ())
    asked = {"monitor": (keys.view(keys.ANY, keys.ANY, keys.ANY),), "hub": ()}
    assert grant.request == asked.get(name, (keys.join(keys.ANY, name),))
    for key in (keys.weights("run", "low"), keys.candidate("run", "low", "best"), keys.control("run", "actor")):
        assert not covers(grant.publish, key)


def test_each_actor_with_a_certificate_has_rights_once_and_nobody_else_gets_any():
    grants = permissions.access_list(2, ["actor-1", "actor-7", "actor-4096", "actor-07", "stranger", "hub", "actor-3"])
    roles = ["trusted", "hub", "monitor", "replay", "learner-high", "learner-low"]
    assert [grant.name for grant in grants] == [*roles, "actor-0", "actor-1", "actor-3", "actor-7"]


@pytest.mark.parametrize("level", ["high", "low"])
def test_a_learner_publishes_and_asks_for_its_own_level_only(level):
    mine, other = GRANTS[f"learner-{level}"], {"high": "low", "low": "high"}[level]
    for key, allowed in (
        (keys.weights("run", level), mine.publish),
        (keys.candidate("run", level, "best"), mine.serve),
        (keys.priority("run", level, 3), mine.publish),
        (keys.sample("run", level), mine.request),
        (keys.sample("run", level, 3), mine.request),
        (keys.control("run", f"learner-{level}"), mine.serve),
    ):
        assert covers(allowed, key)
        assert not covers(allowed, key.replace(level, other))
    everything = mine.publish + mine.serve + mine.request
    for key in (keys.control("run", "actor"), keys.control("run", "scheduler"), keys.push("run", level, "actor-0", 1)):
        assert not covers(everything, key)


def test_the_replay_hears_pushes_and_answers_samples_but_publishes_no_weights_and_no_orders():
    (grant,) = [grant for grant in permissions.access_list(3, shards=2) if grant.name == permissions.REPLAY]
    assert covers(grant.subscribe, keys.push("run", "low", "actor-2", 7))
    for shard in (0, 1):
        assert covers(grant.serve, keys.sample("run", "low", shard))
        assert covers(grant.serve, keys.control("run", f"replay-{shard}" if shard else "replay"))
    assert not covers(grant.serve, keys.control("run", "replay-2"))
    for key in (keys.weights("run", "low"), keys.control("run", "actor"), keys.episodes("run", "actor-0", 1)):
        assert not covers(grant.publish + grant.serve, key)


@pytest.mark.parametrize(
    ("name", "may"), [("actor-0", True), ("actor-4095", True), ("actor-4096", False), ("actor-01", False), ("a", False)]
)
def test_names_of_actors(name, may):
    assert permissions.is_actor_name(name) is may


def test_each_zenoh_rule_names_one_certificate_and_only_its_grants():
    settings = transport_access.settings(GRANTS.values())
    assert settings["default_permission"] == "deny" and settings["enabled"] is True
    assert {tuple(subject["cert_common_names"]) for subject in settings["subjects"]} == {(name,) for name in GRANTS}
    rules = {rule["id"]: rule for rule in settings["rules"]}
    assert all(rule["permission"] == "allow" and "delete" not in rule["messages"] for rule in rules.values())
    for policy in settings["policies"]:
        (name,) = policy["subjects"]
        puts = [rules[rule] for rule in policy["rules"] if rules[rule]["messages"] == ["put"]]
        for rule in puts:
            granted = GRANTS[name].publish if rule["flows"] == ["ingress"] else GRANTS[name].subscribe
            assert tuple(rule["key_exprs"]) == granted
