import pytest
from rehearsal import kinematic

from zsdist.config import Config, load, parse
from zsdist.errors import ConfigError, TransportError
from zsdist.roles import permissions
from zsdist.run import preflight
from zsdist.transport import certificates
from zsdist.wire.messages import State


def test_a_replay_that_could_outgrow_its_memory_is_refused_with_both_sizes():
    preflight.check_memory(load())
    small = load(overrides=("replay.max_bytes=1000000",))
    with pytest.raises(ConfigError, match=r"both levels would take \d+ bytes; allowed by replay.max_bytes are 1000000"):
        preflight.check_memory(small)


@pytest.mark.parametrize(("shards", "held", "fits"), [(1, 1, True), (2, 1, True), (2, 2, True), (1, 2, False)])
def test_a_run_has_at_least_the_shards_of_its_checkpoint(shards, held, fits):
    config = parse({"replay": {"shards": shards}, "run": {"actors": 2}})
    names = ["scheduler", "learner-low", "replay", "replay-1"][: 2 + held]
    states = {name: State(name, {}, {}) for name in names}
    if fits:
        preflight.check_shards(config, states)
    else:
        with pytest.raises(ConfigError, match=r"replay\.shards is 1 and the checkpoint holds 2"):
            preflight.check_shards(config, states)


def test_every_role_on_this_machine_needs_its_certificate(tmp_path):
    preflight.check_certificates(parse({}))  # without `tls` no certificate is needed
    certificates.make(tmp_path, permissions.HUB, permissions.client_names(1), ["127.0.0.1"], days=1)
    settings = {"transport": {"tls": str(tmp_path), "endpoint": "tls/192.0.2.1:7447"}}
    preflight.check_certificates(parse(settings | {"run": {"actors": 1}}))
    with pytest.raises(TransportError, match=r"actor-1"):
        preflight.check_certificates(parse(settings | {"run": {"actors": 2}}))
    preflight.check_certificates(parse(settings | {"run": {"actors": 2, "address": "auto"}}))  # actors run elsewhere


def test_a_trial_drives_the_parts_of_an_actor():
    config = load(overrides=("scenes.train=[singleton]",))
    parts = kinematic(config)
    driven = []
    make_env = parts.make_env

    def counted():
        driven.append(make_env())
        return driven[-1]

    preflight.try_out(type(parts)(counted, parts.visual_act, parts.schedule), config)
    (env,) = driven
    assert env.scene.name.startswith("singleton")


def test_places_on_a_cluster_are_refused_where_there_is_none():
    override = "cluster.actor.gpus=1"
    with pytest.raises(ConfigError, match=r"cluster\.actor\.gpus was given.*allowed with --address"):
        preflight.check_used(load(None, (override,)), (override,))
    with pytest.raises(ConfigError, match=r"cluster\.hubs was given"):
        preflight.check_used(Config(), ("cluster={hubs: []}",))
    on_one = ("run.address=auto", "transport.endpoint=tls/10.0.0.1:7447", "transport.tls=certs", override)
    preflight.check_used(load(None, on_one), on_one)
    preflight.check_used(load(None, (override,)), ())  # of a file that also serves runs on a cluster
