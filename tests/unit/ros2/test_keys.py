import pytest

from zsdist.ros2 import keys, messages
from zsdist.ros2.keys import DEFAULT_DEPTH, EntityKind, QualityOfService

TWIST_HASH = "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"


def test_a_topic_has_the_key_of_rmw_zenoh():
    assert keys.topic_key(7, "/robot/cmd_vel", messages.TWIST) == (
        f"7/robot/cmd_vel/geometry_msgs::msg::dds_::Twist_/{TWIST_HASH}"
    )


def test_tokens_are_those_of_rmw_zenoh():
    quality = QualityOfService(depth=10)
    assert keys.node_token(0, "aabb", 0, "driver") == "@ros2_lv/0/aabb/0/0/NN/%/%/driver"
    token = keys.endpoint_token(0, "aabb", 0, 3, EntityKind.PUBLISHER, "driver", "/a/b", messages.TWIST, quality)
    assert token == (
        f"@ros2_lv/0/aabb/0/3/MP/%/%/driver/%a%b/geometry_msgs::msg::dds_::Twist_/{TWIST_HASH}/::,10:,:,:,,"
    )


@pytest.mark.parametrize(
    ("quality", "token"),
    [
        (QualityOfService(), "::,10:,:,:,,"),
        (QualityOfService(depth=DEFAULT_DEPTH), "::,:,:,:,,"),
        (keys.SENSOR_DATA, "2::,5:,:,:,,"),
    ],
)
def test_quality_of_service_leaves_out_what_is_the_default(quality, token):
    assert quality.token() == token


@pytest.mark.parametrize("further", ["", "/backends:cpu"])
def test_a_token_is_read_back_also_with_parts_of_newer_releases(further):
    token = keys.endpoint_token(
        4, "aa", 0, 3, EntityKind.PUBLISHER, "teleop", "/cmd_vel", messages.TWIST, QualityOfService(), "/robot"
    )
    entity = keys.read_token(token + further)
    assert (entity.domain, entity.session, entity.kind, entity.node) == (4, "aa", "MP", "/robot/teleop")
    assert (entity.topic, entity.hash) == ("/cmd_vel", TWIST_HASH)


def test_a_token_of_a_node_is_read_back():
    entity = keys.read_token(keys.node_token(0, "aa", 0, "robot"))
    assert (entity.kind, entity.node, entity.topic) == ("NN", "/robot", "")


@pytest.mark.parametrize("token", ["", "a/b", "@ros2_lv/x/aa/0/0/NN/%/%/n", "@ros2_lv/0/aa/0/0/MP/%/%/n"])
def test_what_is_no_token_describes_nothing(token):
    assert keys.read_token(token) is None


@pytest.mark.parametrize(("given", "topic"), [("cmd_vel", "/cmd_vel"), ("/a/b_2", "/a/b_2")])
def test_topics_are_absolute(given, topic):
    assert keys.absolute_topic(given) == topic


@pytest.mark.parametrize("given", ["", "/", "a//b", "a b", "/2d", "*", "a/**"])
def test_a_wrong_topic_is_refused_by_its_name(given):
    with pytest.raises(ValueError, match="topic is"):
        keys.absolute_topic(given)
