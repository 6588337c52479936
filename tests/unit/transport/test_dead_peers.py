import os
import socket
from pathlib import Path

import pytest
from sockets import free_endpoint

from zsdist.roles import permissions
from zsdist.transport import certificates, dead_peers
from zsdist.transport.session_config import LEASE_S
from zsdist.transport.zenoh import ZenohHub, ZenohTransport

pytestmark = pytest.mark.skipif(not hasattr(socket, "TCP_USER_TIMEOUT"), reason="the system has no such option")


def options_of(port, level, option):
    """Return an option of all sockets of this process at a port, each once: one that listens, and connections."""
    return [one.getsockopt(level, option) for one in dead_peers.open_sockets() if one.getsockname()[1] == port]


def patience_ms(port):
    return options_of(port, socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)


def test_a_connection_has_the_patience_of_the_socket_that_listened_and_others_have_not():
    with socket.create_server(("127.0.0.1", 0)) as listening, socket.create_server(("127.0.0.1", 0)) as other:
        port, before = listening.getsockname()[1], set(os.listdir("/proc/self/fd"))
        assert dead_peers.give_up_after(port, 2.5) == 1
        assert set(os.listdir("/proc/self/fd")) == before
        with socket.create_connection(listening.getsockname()), listening.accept()[0]:
            assert patience_ms(port) == [2500, 2500]
        assert patience_ms(other.getsockname()[1]) == [0]


@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_a_hub_gives_up_what_is_cut_off_soon_after_its_lease_and_has_room_for_what_is_sent_until_then(
    tmp_path, protocol
):
    own, grants = dict.fromkeys((permissions.HUB, permissions.TRUSTED)), ()
    if protocol == "tls":
        certificates.make(tmp_path, permissions.HUB, permissions.client_names(1), ["127.0.0.1"], 1)
        own = {name: certificates.Identity.load(tmp_path, name) for name in own}
        grants = permissions.access_list(1)
    with ZenohHub(free_endpoint(protocol), own[permissions.HUB], grants) as hub:
        port = int(hub.endpoint.rpartition(":")[2])
        client = ZenohTransport(hub.endpoint, own[permissions.TRUSTED])
        assert patience_ms(port) == [int(1000 * (LEASE_S + 1))] * 2
        room = options_of(port, socket.SOL_SOCKET, socket.SO_SNDBUF)
        client.close()
    allowed = int(Path("/proc/sys/net/core/wmem_max").read_text())
    assert max(room) == 2 * min(allowed, dead_peers.SEND_BUFFER_BYTES)  # of the connection; none has room to listen
