import json

from zsdist.roles import permissions
from zsdist.transport.session_config import session_config


def setting(config, key):
    return json.loads(config.get_json(key))


def test_a_hub_accepts_as_many_clients_as_a_run_may_have_actors_and_more():
    hub = session_config("router", listen="tcp/127.0.0.1:7447")
    assert setting(hub, "transport/unicast/max_sessions") > permissions.MAX_ACTORS + 1000
    assert setting(hub, "transport/unicast/accept_pending") >= 1000
