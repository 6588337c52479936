"""Permissions of each certificate at a hub with TLS, tested by plain zenoh sessions over real sockets.

A blocked message is noticed without waiting: an allowed one is sent after it on the same connection, and arrives alone.
"""

import itertools
import json
import time

import pytest
import zenoh
from rehearsal import rehearse, start
from sockets import PATIENCE_S, Inbox, free_endpoint

from zsdist.errors import TransportError
from zsdist.roles import permissions
from zsdist.transport import certificates
from zsdist.transport.base import Message
from zsdist.transport.certificates import Identity
from zsdist.transport.zenoh import ZenohHub, ZenohTransport

pytestmark = pytest.mark.integration

ACTORS, HOST = 2, "127.0.0.1"
RUN = "zsdist/demo"
NUMBERS = itertools.count()
OTHERS = ("actor-7", "stranger")  # certified by the authority, but not on the access list
OF_ACTOR_0 = ("push/low/actor-0/3", "push/high/actor-0/3", "episodes/actor-0/3", "evaluation/actor-0", "stats/actor/0")
NOT_OF_ACTOR_0 = (
    "weights/low",
    "candidate/low/recent",
    "control/actor",
    "control/scheduler",
    "ack/actor-0",
    "ack/actor-1",
    "push/low/actor-1/3",
    "push/low/*/3",
    "push/**",
    "episodes/actor-1/3",
    "evaluation/actor-1",
    "stats/actor/1",
    "stats/learner/low",
    "priority/low",
    "events",
)
TO_ACTOR_0 = ("weights/low", "candidate/high/recent", "control/actor", "ack/actor-0", "evaluation/actor-0")
NOT_TO_ACTOR_0 = ("push/low/actor-1/3", "ack/actor-1", "evaluation/actor-1", "control/replay", "episodes/actor-1/3")
OF_LEARNER_LOW = ("weights/low", "candidate/low/best", "priority/low", "priority/low/3", "stats/learner/low", "events")
NOT_OF_LEARNER_LOW = ("weights/high", "candidate/high/best", "priority/high", "control/actor", "ack/actor-0")
OF_REPLAY = ("ack/actor-0", "stats/replay/0", "events")
NOT_OF_REPLAY = ("weights/low", "candidate/low/best", "control/actor", "control/scheduler", "push/low/actor-0/3")
TO_MONITOR = ("stats/actor/0", "events", "weights/low")
NOT_TO_MONITOR = ("push/low/actor-0/3", "ack/actor-0", "control/actor", "candidate/low/best", "evaluation/actor-0")


class Client:
    """A plain zenoh session with a certificate."""

    def __init__(self, endpoint: str, identity: Identity | None, timeout_ms: int = 10_000) -> None:
        settings = {"mode": "client", "connect/endpoints": [endpoint], "connect/timeout_ms": timeout_ms}
        settings |= {"connect/exit_on_failure": True, "scouting/multicast/enabled": False}
        if identity is not None:
            settings["transport/link/tls"] = {
                "root_ca_certificate": str(identity.authority),
                "connect_certificate": str(identity.certificate),
                "connect_private_key": str(identity.key),
                "enable_mtls": True,
            }
        config = zenoh.Config()
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        self.session = zenoh.open(config)
        self.kept = []

    def put(self, key: str, payload: bytes = b"") -> None:
        self.session.put(f"{RUN}/{key}", payload)

    def hear(self, *patterns: str) -> Inbox:
        box = Inbox()
        for pattern in patterns:
            self.kept.append(self.session.declare_subscriber(f"{RUN}/{pattern}", lambda sample: _keep(box, sample)))
        return box

    def ask(self, key: str) -> list[bytes]:
        """Return all answers; empty where the request is refused."""
        replies = self.session.get(f"{RUN}/{key}", payload=b"?", timeout=0.5)
        return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]

    def ask_until_known(self, key: str) -> list[bytes]:
        """Return the answers as soon as there are any: a service takes a while to become known."""
        began_s = time.monotonic()
        while not (answers := self.ask(key)):
            assert time.monotonic() - began_s < PATIENCE_S, f"nobody answered {key}"
        return answers

    def answer(self, key: str, payload: bytes) -> None:
        self.kept.append(
            self.session.declare_queryable(f"{RUN}/{key}", lambda query: query.reply(query.key_expr, payload))
        )

    def alive(self) -> set[str]:
        replies = self.session.liveliness().get(f"{RUN}/alive/*/*", timeout=0.5)
        return {str(reply.ok.key_expr).removeprefix(f"{RUN}/") for reply in replies if reply.ok is not None}


def _keep(box: Inbox, sample: zenoh.Sample) -> None:
    box.append(Message(str(sample.key_expr), sample.payload.to_bytes()))


def heard(box: Inbox, send: Client, key: str) -> set[str]:
    """Return the keys of the messages that arrive in `box` before one that `send` may send under `key`."""
    last, tries = b"last %d" % next(NUMBERS), 0
    box.seen.clear()
    while not any(message.payload == last for message in box.seen):
        send.put(key, last)  # repeatedly: a subscription takes a while to become known
        tries += 1
        assert tries < 50 * PATIENCE_S, f"nothing came under {key}"
        box.wait(len(box.seen) + 1, 0.02)
    return {message.key.removeprefix(f"{RUN}/") for message in box.seen}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("certificates")
    certificates.make(folder, permissions.HUB, [*permissions.client_names(ACTORS), *OTHERS], [HOST], days=1)
    return folder


@pytest.fixture(scope="module")
def hub(folder):
    with ZenohHub(free_endpoint("tls"), Identity.load(folder, permissions.HUB), permissions.access_list(ACTORS)) as hub:
        yield hub


@pytest.fixture
def connect(hub, folder):
    """Return a function that connects a client with the certificate of a name."""
    opened = []

    def make(name: str) -> Client:
        opened.append(Client(hub.endpoint, Identity.load(folder, name)))
        return opened[-1]

    yield make
    for client in opened:
        client.session.close()


def test_an_actor_publishes_under_its_own_name_and_nothing_else(connect):
    trusted, actor = connect(permissions.TRUSTED), connect("actor-0")
    box = trusted.hear("**")
    assert heard(box, actor, OF_ACTOR_0[0]) == {OF_ACTOR_0[0]}
    for key in NOT_OF_ACTOR_0:
        actor.put(key)
        actor.session.delete(f"{RUN}/{key}")
    for key in OF_ACTOR_0:
        actor.session.delete(f"{RUN}/{key}")
        actor.put(key)
    assert heard(box, actor, OF_ACTOR_0[-1]) == set(OF_ACTOR_0)
    assert len([message for message in box.seen if not message.payload]) == len(OF_ACTOR_0)


def test_an_actor_receives_its_own_messages_and_no_others(connect):
    trusted, actor = connect(permissions.TRUSTED), connect("actor-0")
    for key in TO_ACTOR_0:
        assert heard(actor.hear(key), trusted, key) == {key}
    box = actor.hear("**", "*/*", "*/*/*/*", *NOT_TO_ACTOR_0, TO_ACTOR_0[0])
    heard(box, trusted, TO_ACTOR_0[0])
    for key in NOT_TO_ACTOR_0:
        trusted.put(key)
    assert heard(box, trusted, TO_ACTOR_0[0]) == {TO_ACTOR_0[0]}


def test_an_actor_can_neither_request_batches_or_states_nor_serve_them(connect):
    trusted, learner = connect(permissions.TRUSTED), connect(permissions.TRUSTED)
    actor, forger = connect("actor-0"), connect("actor-1")
    for key in ("sample/low", "control/replay", "control/learner-low"):
        trusted.answer(key, b"true")
        forger.answer(key, b"forged")
    forger.answer("weights/low", b"forged")
    for key in ("sample/low", "control/replay", "control/learner-low"):
        assert learner.ask_until_known(key) == [b"true"]
    assert actor.ask("sample/low") == actor.ask("control/replay") == []
    assert learner.ask("weights/low") == []


@pytest.mark.parametrize(
    ("name", "own", "foreign"),
    [("learner-low", OF_LEARNER_LOW, NOT_OF_LEARNER_LOW), (permissions.REPLAY, OF_REPLAY, NOT_OF_REPLAY)],
)
def test_a_learner_and_the_replay_publish_what_is_theirs_and_nothing_else(connect, name, own, foreign):
    trusted, client = connect(permissions.TRUSTED), connect(name)
    box = trusted.hear("**")
    assert heard(box, client, own[0]) == {own[0]}
    for key in (*foreign, *own[1:]):
        client.put(key)
    assert heard(box, client, own[0]) == set(own)


def test_learners_ask_the_replay_for_batches_of_their_level_and_nobody_else_answers(connect):
    learner, replay, forger = connect("learner-low"), connect(permissions.REPLAY), connect("learner-high")
    for key in ("sample/low", "sample/high", "control/replay"):
        forger.answer(key, b"forged")
        replay.answer(key, b"true")
    while not (answer := learner.ask("sample/low")):
        pass
    assert answer == [b"true"] and learner.ask("sample/high") == learner.ask("control/replay") == []
    assert connect(permissions.TRUSTED).ask("control/replay") == [b"true"]


def test_the_replay_hears_pushes_and_orders_and_a_learner_hears_orders_alone(connect):
    trusted, replay, learner = connect(permissions.TRUSTED), connect(permissions.REPLAY), connect("learner-low")
    for client, key in ((replay, "push/low/actor-1/3"), (replay, "control/replay"), (learner, "control/learner")):
        assert heard(client.hear(key), trusted, key) == {key}
    box = learner.hear("push/**", "ack/*", "control/learner")
    trusted.put("push/low/actor-1/3")
    trusted.put("ack/actor-0")
    assert heard(box, trusted, "control/learner") == {"control/learner"}


def test_an_actor_can_declare_its_own_token_and_no_other(connect):
    actor, watcher = connect("actor-0"), connect(permissions.MONITOR)
    tokens = [actor.session.liveliness().declare_token(f"{RUN}/alive/{who}") for who in ("learner/low", "actor/1")]
    tokens.append(actor.session.liveliness().declare_token(f"@retained/{RUN}/weights/low"))
    tokens.append(actor.session.liveliness().declare_token(f"{RUN}/alive/actor/0"))
    while not (alive := watcher.alive()):
        pass
    assert alive == {"alive/actor/0"}
    replies = connect(permissions.TRUSTED).session.liveliness().get("@retained/**", timeout=0.5)
    assert [reply for reply in replies if reply.ok] == []


def test_an_actor_asks_to_join_under_its_own_name_and_sees_which_runs_there_are(connect):
    trusted, actor = connect(permissions.TRUSTED), connect("actor-0")
    trusted.answer("join/*", b"terms")
    assert actor.ask_until_known("join/actor-0") == [b"terms"]
    assert actor.ask("join/actor-1") == actor.ask("join/*") == []
    connect("actor-1").answer("join/actor-0", b"forged")
    assert actor.ask_until_known("join/actor-0") == [b"terms"]
    tokens = [trusted.session.liveliness().declare_token(f"{RUN}/alive/{who}") for who in ("scheduler/0", "replay/0")]
    seen = set()
    while not seen:
        replies = actor.session.liveliness().get("zsdist/*/alive/scheduler/*", timeout=0.5)
        seen = {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
    assert seen == {f"{RUN}/alive/scheduler/0"} and actor.alive() == set()
    del tokens


def test_a_monitor_receives_statistics_events_weights_and_tokens_and_nothing_else(connect):
    trusted, monitor = connect(permissions.TRUSTED), connect(permissions.MONITOR)
    for key in TO_MONITOR:
        assert heard(monitor.hear(key), trusted, key) == {key}
    box = monitor.hear("**", *NOT_TO_MONITOR, "events")
    heard(box, trusted, "events")
    for key in NOT_TO_MONITOR:
        trusted.put(key)
    assert heard(box, trusted, "events") == {"events"}
    token = trusted.session.liveliness().declare_token(f"{RUN}/alive/scheduler/0")
    while not (alive := monitor.alive()):
        pass
    assert alive == {"alive/scheduler/0"}
    token.undeclare()


@pytest.mark.parametrize("name", [permissions.MONITOR, permissions.HUB, *OTHERS])
def test_other_clients_can_change_nothing(connect, name):
    trusted, client = connect(permissions.TRUSTED), connect(name)
    box = trusted.hear("**")
    heard(box, connect(permissions.TRUSTED), "events")
    trusted.answer("control/replay", b"state")
    client.answer("sample/low", b"forged")
    for key in (*OF_ACTOR_0, *NOT_OF_ACTOR_0[:-1], "events" if name != permissions.HUB else "sample/low"):
        client.put(key, b"forged")
    token = client.session.liveliness().declare_token(f"{RUN}/alive/learner/low")
    assert client.ask("control/replay") == []  # by now the hub has handled all earlier messages
    assert trusted.ask("sample/low") == []
    assert trusted.alive() == set()
    assert heard(box, connect(permissions.TRUSTED), "events") == {"events"}
    token.undeclare()


@pytest.mark.parametrize("name", OTHERS)
def test_an_unlisted_name_receives_nothing(connect, name):
    trusted, client = connect(permissions.TRUSTED), connect(name)
    control, box = connect(permissions.MONITOR).hear("stats/actor/0"), client.hear("**", *TO_ACTOR_0, *TO_MONITOR)
    assert client.ask("weights/low") == []
    heard(control, trusted, "stats/actor/0")
    for key in (*TO_ACTOR_0, *TO_MONITOR):
        trusted.put(key)
    assert client.alive() == set()
    assert box.seen == box.drain() == []


def test_no_client_connects_without_a_certificate_of_the_authority(hub, folder, tmp_path):
    certificates.make(tmp_path, permissions.HUB, [permissions.TRUSTED], [HOST], days=1)
    for endpoint, identity in (
        (hub.endpoint, None),
        (hub.endpoint.replace("tls", "tcp"), None),
        (hub.endpoint, Identity.load(tmp_path, permissions.TRUSTED)),
    ):
        with pytest.raises(zenoh.ZError):
            Client(endpoint, identity, timeout_ms=500)
    with pytest.raises(TransportError, match=r"no hub answers at .* or it refuses certificate .*trusted\.pem"):
        ZenohTransport(hub.endpoint, Identity.load(tmp_path, permissions.TRUSTED), connect_timeout_s=0.5)


@pytest.mark.parametrize("pretender", ["actor-0", "elsewhere", "other authority"])
def test_no_client_connects_to_a_hub_with_a_wrong_certificate(folder, tmp_path, pretender):
    mine = Identity.load(folder, permissions.TRUSTED)
    if pretender == "actor-0":
        shown = Identity.load(folder, pretender)
    else:
        if pretender == "elsewhere":
            for file in ("ca.pem", "ca.key"):
                (tmp_path / file).write_bytes((folder / file).read_bytes())
        certificates.make(tmp_path, permissions.HUB, [], ["hub.example" if pretender == "elsewhere" else HOST], days=1)
        shown = Identity.load(tmp_path, permissions.HUB)
    with ZenohHub(free_endpoint("tls"), shown) as hub, pytest.raises(TransportError, match="no hub answers"):
        ZenohTransport(hub.endpoint, mine, connect_timeout_s=0.5)


def test_a_whole_run_works_with_certificates(folder, tmp_path):
    transport = f"transport={{kind: zenoh, tls: {folder}, endpoint: {free_endpoint('tls')}}}"
    spec = start(tmp_path / "run", transport, f"run.actors={ACTORS}")
    summary = rehearse(spec)
    assert (spec.folder / "endpoint").read_text().startswith("tls/")
    assert summary["ended"] == "complete"
    assert len(summary["merges"]) == 2  # candidates, drives and promotions got through
    for books in summary["transitions"].values():
        assert books["produced"] == books["stored"] + books["rejected"] > 0
