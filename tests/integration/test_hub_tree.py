"""Hubs in a tree, one for each rack: clients of any of them reach each other, with certificates, as at one hub."""

import time
from contextlib import ExitStack, closing

import pytest
from sockets import PATIENCE_S, Inbox, free_endpoint

from zsdist.roles import permissions
from zsdist.transport import certificates
from zsdist.transport.certificates import Identity
from zsdist.transport.pieces import LOST_AFTER_MAX_S
from zsdist.transport.zenoh import ZenohHub, ZenohTransport
from zsdist.wire import keys

pytestmark = pytest.mark.integration

PUSH = keys.push("r", "low", "actor-0", 1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("certificates")
    certificates.make(folder, permissions.HUB, permissions.client_names(2), ["127.0.0.1"], days=1)
    return folder


@pytest.fixture
def tree(folder):
    """Open a hub of the tree, a client of one: both are closed at the end."""
    with ExitStack() as opened:

        def hub(endpoint, root=None, **options):
            grants = permissions.access_list(2, hubs=3)
            identity = Identity.load(folder, permissions.HUB)
            return opened.enter_context(ZenohHub(endpoint, identity, grants, ports_tried=1, root=root, **options))

        def client(name, endpoint, **options):
            identity = Identity.load(folder, name)
            return opened.enter_context(closing(ZenohTransport(endpoint, identity, **options)))

        yield hub, client


def endpoints():
    return [free_endpoint("tls") for _ in range(3)]


def until_heard(box, publish):
    """Publish again and again, as roles do, until something arrives; return what did."""
    deadline = time.monotonic() + PATIENCE_S
    while not box.wait(1, 0.1):
        assert time.monotonic() < deadline
        publish()
    return box.seen


def test_pushes_weights_samples_and_tokens_pass_from_rack_to_rack(tree):
    hub, client = tree
    root, one, two = endpoints()
    hub(one, root)  # before the run's own hub is there
    hub(root), hub(two, root)
    learner, actor, replay = client("learner-low", root), client("actor-0", one), client("replay", two)

    pushes = Inbox()
    replay.subscribe(keys.push("r", keys.ANY, keys.ANY, keys.ANY), pushes)
    assert until_heard(pushes, lambda: actor.publish(PUSH, b"frame"))[0].payload == b"frame"

    news, large = Inbox(), b"w" * 3_000_000  # travels in pieces
    learner.publish(keys.weights("r", "low"), large, retained=True)
    actor.subscribe(keys.weights("r", keys.ANY), news, retained=True)
    assert [message.payload for message in news.wait(1, PATIENCE_S + LOST_AFTER_MAX_S)] == [large]

    asked, answers = Inbox(), Inbox()
    replay.serve(keys.sample("r", "low"), asked)
    until_heard(asked, lambda: learner.request(keys.sample("r", "low"), b"?", answers, timeout_s=PATIENCE_S))
    asked.seen[0].reply(b"batch")
    assert answers.wait()[0].payload == b"batch"

    tokens = Inbox()
    client("trusted", two).watch_alive(keys.alive("r", keys.ANY, keys.ANY), tokens)
    actor.declare_alive(keys.alive("r", "actor", "0"))
    assert tokens.wait()[0].payload == b"1"
    actor.close()
    assert tokens.wait(2)[1].payload == b"0"


def test_the_hub_of_a_rack_refuses_what_the_run_s_own_would_refuse(tree):
    hub, client = tree
    root, one, two = endpoints()
    hub(root), hub(one, root), hub(two, root)
    actor, forger, replay = client("actor-0", one), client("actor-1", one), client("trusted", two)
    everything = Inbox()
    replay.subscribe("zsdist/**", everything)
    until_heard(everything, lambda: actor.publish(PUSH, b"before"))
    forger.publish(PUSH, b"forged")
    forger.publish(keys.weights("r", "low"), b"forged")
    own = keys.push("r", "low", "actor-1", 1)
    forger.publish(own, b"own")
    heard = everything.wait_for(lambda seen: any(message.key == own for message in seen))
    assert {message.payload for message in heard} == {b"before", b"own"}


def test_a_hub_that_comes_again_is_joined_again_and_a_client_finds_another_one_meanwhile(tree):
    hub, client = tree
    root, one, two = endpoints()
    own = hub(root)
    branch = hub(one, root)
    hub(two, root)
    actor, replay, pushes = client("actor-0", one, others=(root,)), client("replay", two), Inbox()
    replay.subscribe(keys.push("r", keys.ANY, keys.ANY, keys.ANY), pushes)
    until_heard(pushes, lambda: actor.publish(PUSH, b"through its rack"))
    own.close()
    hub(root, succeeds_root=True)
    pushes.seen.clear()
    until_heard(pushes, lambda: actor.publish(PUSH, b"through the new root"))
    branch.close()
    pushes.seen.clear()
    until_heard(pushes, lambda: actor.publish(PUSH, b"through the root itself"))
