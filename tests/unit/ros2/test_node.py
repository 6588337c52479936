import threading

import pytest
import zenoh
from sockets import free_endpoint

from zsdist.errors import TransportError
from zsdist.ros2 import attachment, keys, messages
from zsdist.ros2.keys import QualityOfService
from zsdist.ros2.messages import Velocity
from zsdist.ros2.node import NewestMessage, RosNode

PATIENCE_S = 10.0


class Heard(NewestMessage):
    def __init__(self):
        self.woken = threading.Event()
        super().__init__(self.woken.set)

    def wait(self):
        assert self.woken.wait(PATIENCE_S)
        self.woken.clear()
        return self.take()


@pytest.fixture
def pair():
    endpoint = free_endpoint()
    with RosNode("robot", listen=endpoint, domain=3) as robot, RosNode("driver", connect=endpoint, domain=3) as driver:
        yield robot, driver


def until(condition):
    waiting = threading.Event()
    for _ in range(1000):
        if condition():
            return True
        waiting.wait(0.01)
    return False


def test_a_message_arrives_with_its_attachment_and_a_newer_one_replaces_it(pair):
    robot, driver = pair
    heard = Heard()
    robot.subscribe("/cmd_vel", messages.TWIST, heard.put)
    publisher = driver.publisher("/cmd_vel", messages.TWIST, QualityOfService())
    assert until(lambda: publisher.matched)
    publisher.publish(messages.encode_twist(Velocity(0.1, 0.0)))
    first = heard.wait()
    assert messages.decode_twist(first.data) == Velocity(0.1, 0.0)
    assert (first.attachment.sequence, first.attachment.gid) == (1, publisher.gid)
    for speed in (0.2, 0.3):
        publisher.publish(messages.encode_twist(Velocity(speed, 0.0)))
    assert until(lambda: heard.count == 3)
    last = heard.take()
    assert messages.decode_twist(last.data).speed_mps == 0.3 and last.attachment.sequence == 3
    assert heard.take() is None


def test_a_message_without_an_attachment_is_dropped_but_overheard(pair):
    robot, driver = pair
    heard, overheard = Heard(), Heard()
    driver.subscribe("/cmd_vel", messages.TWIST, heard.put)
    driver.overhear("/cmd_vel", overheard.put_any)
    config = zenoh.Config()
    for key, value in (("mode", '"client"'), ("connect/endpoints", f'["{robot.endpoint}"]')):
        config.insert_json5(key, value)
    with zenoh.open(config) as stranger:
        publisher = stranger.declare_publisher(keys.topic_key(3, "/cmd_vel", messages.TWIST))
        assert until(lambda: publisher.matching_status.matching)
        publisher.put(messages.encode_twist(Velocity(0.1, 0.0)))
        assert overheard.wait().attachment is None
        assert until(lambda: heard.nameless == 1) and heard.take() is None


def test_publishers_of_a_topic_are_known_by_their_tokens_and_own_messages_are_not_overheard(pair):
    robot, driver = pair
    found, overheard = driver.publishers_of("/cmd_vel"), Heard()
    driver.overhear("/cmd_vel", overheard.put_any)
    own = driver.publisher("/cmd_vel", messages.TWIST, QualityOfService())
    own.publish(messages.encode_twist(Velocity(0.1, 0.0)))
    other = robot.publisher("/cmd_vel", messages.TWIST_STAMPED, QualityOfService())
    assert until(lambda: {entity.node for entity in found.entities()} == {"/driver", "/robot"})
    other.close()
    assert until(lambda: {entity.node for entity in found.entities()} == {"/driver"})
    assert overheard.count == 0


def test_a_node_knows_whether_its_router_is_there():
    endpoint = free_endpoint()
    router = RosNode("robot", listen=endpoint)
    with RosNode("driver", connect=endpoint) as driver:
        assert until(lambda: driver.connected)
        router.close()
        assert until(lambda: not driver.connected)


def test_without_a_router_the_error_says_what_to_do():
    with pytest.raises(TransportError, match=r"no zenoh router answers at tcp/127\.0\.0\.1:\d+ within 0\.3 s"):
        RosNode("driver", connect=free_endpoint(), timeout_s=0.3)


def test_a_taken_port_is_an_error():
    endpoint = free_endpoint()
    with RosNode("robot", listen=endpoint), pytest.raises(TransportError, match="cannot open a router"):
        RosNode("robot", listen=endpoint)


def test_gids_are_those_of_attachments(pair):
    publisher = pair[1].publisher("/a", messages.BOOL, QualityOfService())
    assert len(publisher.gid) == attachment.GID_BYTES
