"""Independent clients of ROS 2 over zenoh against ours. `make peers` installs them; the tests are skipped without."""

import json
import os
import subprocess
import threading
from pathlib import Path

import pytest
from sockets import free_endpoint

from zsdist.ros2 import messages
from zsdist.ros2.keys import QualityOfService
from zsdist.ros2.messages import Velocity
from zsdist.ros2.node import NewestMessage, RosNode

pytestmark = pytest.mark.integration

ROOT = Path(__file__).parents[2]
PYTHON = Path(os.environ.get("ZSDIST_PEERS", ROOT / ".peers")) / "ros2" / "bin" / "python"
PATIENCE_S = 60.0
NEEDED = pytest.mark.skipif(not PYTHON.exists(), reason=f"{PYTHON} is missing: run make peers")

SUBSCRIBER = """
import json, sys, threading
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Subscriber
store, kind = get_typestore(Stores.ROS2_JAZZY), "geometry_msgs/msg/Twist"
done = threading.Event()
def heard(message):
    print(json.dumps([message.linear.x, message.angular.z]), flush=True)
    done.set()
definition, _ = store.generate_msgdef(kind, ros_version=2)
subscriber = ROS2Subscriber("/cmd_vel", kind, heard, msg_definition=definition, type_hash=store.hash_rihs01(kind),
                            router_port=int(sys.argv[1]))
print("ready", flush=True)
done.wait(50)
"""

PUBLISHER = """
import sys, time
import numpy as np
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Publisher
store = get_typestore(Stores.ROS2_JAZZY)
made = lambda name, **fields: store.types[name](**fields)
def publisher(topic, kind):
    definition, _ = store.generate_msgdef(kind, ros_version=2)
    return ROS2Publisher(topic, kind, msg_definition=definition, type_hash=store.hash_rihs01(kind),
                         router_port=int(sys.argv[1]))
odometry = publisher("/odom", "nav_msgs/msg/Odometry")
picture = publisher("/camera/image/compressed", "sensor_msgs/msg/CompressedImage")
zero = lambda: made("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
print("ready", flush=True)
for number in range(200):
    stamp = made("builtin_interfaces/msg/Time", sec=7, nanosec=number)
    header = made("std_msgs/msg/Header", stamp=stamp, frame_id="odom")
    pose = made("geometry_msgs/msg/Pose", position=made("geometry_msgs/msg/Point", x=1.5, y=-2.5, z=0.0),
                orientation=made("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=1.0, w=0.0))
    twist = made("geometry_msgs/msg/Twist", linear=zero(), angular=zero())
    odometry.publish(header=header, child_frame_id="base_link",
                     pose=made("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
                     twist=made("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)))
    picture.publish(header=header, format="jpeg", data=np.arange(100, dtype=np.uint8))
    time.sleep(0.05)
"""

DECODER = """
import json, sys
from rosbags.typesys import Stores, get_typestore
store = get_typestore(Stores.ROS2_JAZZY)
for line in sys.stdin:
    kind, hash, data = json.loads(line)
    assert store.hash_rihs01(kind) == hash, kind
    print(json.dumps([kind, repr(store.deserialize_cdr(bytes.fromhex(data), kind))[:200]]), flush=True)
"""


class Heard(NewestMessage):
    def __init__(self):
        self.woken = threading.Event()
        super().__init__(self.woken.set)


@pytest.fixture
def peer():
    started = []

    def start(code, *arguments):
        command = [str(PYTHON), "-c", code, *arguments]
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True, env=environment)
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


@NEEDED
def test_zenoh_ros2_sdk_hears_our_twist(peer):
    endpoint = free_endpoint()
    with RosNode("robot", listen=endpoint) as node:
        publisher = node.publisher("/cmd_vel", messages.TWIST, QualityOfService(depth=1))
        process = peer(SUBSCRIBER, endpoint.rpartition(":")[2])
        assert process.stdout.readline() == "ready\n"
        stop = threading.Event()

        def send():
            while not stop.wait(0.1):
                publisher.publish(messages.encode_twist(Velocity(0.25, -0.5)))

        sender = threading.Thread(target=send)
        sender.start()
        heard = process.stdout.readline()
        stop.set()
        sender.join()
    assert json.loads(heard) == [0.25, -0.5]


@NEEDED
def test_we_hear_the_odometry_and_the_pictures_of_zenoh_ros2_sdk_and_know_it_by_its_token(peer):
    endpoint = free_endpoint()
    poses, pictures = Heard(), Heard()
    with RosNode("robot", listen=endpoint), RosNode("driver", connect=endpoint) as driver:
        driver.subscribe("/odom", messages.ODOMETRY, poses.put)
        driver.subscribe("/camera/image/compressed", messages.COMPRESSED_IMAGE, pictures.put)
        found = driver.publishers_of("/odom")
        process = peer(PUBLISHER, endpoint.rpartition(":")[2])
        assert process.stdout.readline() == "ready\n"
        assert poses.woken.wait(PATIENCE_S) and pictures.woken.wait(PATIENCE_S)
        reading = messages.decode_odometry(poses.take().data)
        assert reading.pose[:2] == (1.5, -2.5) and abs(reading.pose.heading_rad) == pytest.approx(3.14159, abs=1e-4)
        assert bytes(messages.decode_picture(pictures.take().data).data) == bytes(range(100))
        (entity,) = found.entities()
        assert entity.node.startswith("/zenoh_publisher_") and entity.hash == messages.ODOMETRY.hash


@NEEDED
def test_rosbags_decodes_every_message_of_ours_and_computes_the_same_hashes(peer):
    from zsdist.types import Pose

    reading = messages.OdometryReading(5, Pose(1.0, 2.0, 0.5), Velocity(0.1, 0.2))
    picture = messages.CompressedPicture(5, messages.np.arange(9, dtype="uint8"))
    ours = (
        (messages.TWIST, messages.encode_twist(Velocity(0.1, 0.2))),
        (messages.TWIST_STAMPED, messages.encode_twist(Velocity(0.1, 0.2), 5)),
        (messages.ODOMETRY, messages.encode_odometry(reading)),
        (messages.COMPRESSED_IMAGE, messages.encode_picture(picture)),
        (messages.POSE_STAMPED, messages.encode_goal((1.0, 2.0), "odom")),
        (messages.BOOL, messages.encode_bool(True)),
        (messages.CLOCK, messages.encode_clock(5)),
    )
    process = peer(DECODER)
    lines = "".join(json.dumps([kind.name, kind.hash, data.hex()]) + "\n" for kind, data in ours)
    output, _ = process.communicate(lines, timeout=PATIENCE_S)
    assert process.returncode == 0 and len(output.splitlines()) == len(ours)
