"""Checks that try out the parts of a run: camera, vision, zenoh and Ray."""

import importlib.metadata
import os
import threading
import time
from typing import TYPE_CHECKING

import numpy as np

from zsdist.config import Config
from zsdist.diagnostics.result import CheckResult, CheckStatus
from zsdist.errors import CacheError, RunError, WeightsError

if TYPE_CHECKING:
    from zsdist.transport.zenoh import ZenohTransport

MESSAGE_TIMEOUT_S = 3.0


def check_camera() -> CheckResult:
    """Render one picture of a scene."""
    from zsdist.sim.camera import make_camera
    from zsdist.sim.scenes import families

    config, scene = Config().camera, families.draw("iid", "train", 0)
    camera = make_camera(config)
    camera.render(scene, scene.start.pose)
    began_s = time.perf_counter()
    image = camera.render(scene, scene.start.pose)
    taken_ms = 1000 * (time.perf_counter() - began_s)
    if image.std() == 0:
        found = f"{config.back_end}: the picture is empty"
        return CheckResult("camera", CheckStatus.FAIL, found, "Try the other back end (camera.back_end).")
    return CheckResult("camera", CheckStatus.OK, f"{config.back_end}, {config.size_px} px in {taken_ms:.1f} ms")


def check_vision() -> CheckResult:
    """Read every file of the shipped weights, and run each of its networks and the word comparison on one picture."""
    from zsdist.vision import weights_folder
    from zsdist.vision.visual_act import ALONE, VisualAct

    config = Config()
    image = np.zeros((1, config.camera.size_px, config.camera.size_px, 3), dtype=np.uint8)
    optional = (weights_folder.STUDENT_FILE, weights_folder.PROJECTION_FILE, weights_folder.VOCABULARY_FILE)
    found = []
    try:
        weights = weights_folder.read(weights_folder.SHIPPED)
        missing = [file for file in optional if not weights.has(file)]
        for file in weights.metadata["files"]:
            weights.content(file)
        for network in ("head", *(name for name, (file, _) in ALONE.items() if weights.has(file))):
            model = VisualAct.load(config.vision.model_copy(update={"network": network}), config.camera)
            model.read(image)
            began_s = time.perf_counter()
            model.read(image)
            taken_ms = 1000 * (time.perf_counter() - began_s)
            found.append(f"{model.encoder_name}, weights {model.weights_sha256[:12]}, {taken_ms:.1f} ms")
            if network == "head" and weights_folder.PROJECTION_FILE not in missing:
                model.observe(image)
    except CacheError as error:  # `check_cache` gives the advice
        return CheckResult("vision", CheckStatus.FAIL, str(error))
    except WeightsError as error:
        advice = "Install zsdist again (make install, or pip), or train weights: python -m zsdist.pretrain."
        return CheckResult("vision", CheckStatus.FAIL, str(error), advice)
    if missing:
        text = "; ".join([*found, f"no {', '.join(missing)}"])
        advice = "Features that need these files are refused; python -m zsdist.pretrain makes them."
        return CheckResult("vision", CheckStatus.WARN, text, advice)
    return CheckResult("vision", CheckStatus.OK, "; ".join(found))


def check_zenoh() -> CheckResult:
    """Start a hub and two clients on this machine, and send one message from one client to the other."""
    from zsdist.transport.zenoh import ZenohHub, ZenohTransport

    with ZenohHub(Config().transport.endpoint) as hub:
        return send_message("zenoh", hub.endpoint, [ZenohTransport(hub.endpoint) for _ in range(2)])


def check_ray() -> CheckResult:
    """Start Ray on this machine as a run does, and end it."""
    from zsdist.run import cluster_address, local_ray

    before = dict(os.environ)
    local_ray.stay_on_loopback()
    from zsdist.run import ray_cluster

    version = f"version {importlib.metadata.version('ray')}"
    began_s = time.perf_counter()
    try:
        cluster_address.check(Config())
        ray_cluster.try_start()
    except RunError as error:
        advice = "Correct that, or train in one process: python -m zsdist.launch --single-process."
        return CheckResult("ray", CheckStatus.FAIL, f"{version}; {error}", advice)
    finally:  # its address and token were for that Ray alone
        os.environ.clear()
        os.environ.update(before)
    return CheckResult("ray", CheckStatus.OK, f"{version}, started in {time.perf_counter() - began_s:.1f} s")


def send_message(check: str, endpoint: str, clients: "list[ZenohTransport]") -> CheckResult:
    """Send a message from the second client to the first, and close both.

    Args:
        check: name of the check.
        endpoint: endpoint of their hub, for the result's text.
        clients: two connected clients.
    """
    from zsdist.transport.base import Mailbox

    arrived, key = threading.Event(), "zsdist/doctor/events"
    try:
        clients[0].subscribe(key, Mailbox(1024, arrived.set))
        began_s = time.perf_counter()
        while not arrived.is_set() and time.perf_counter() - began_s < MESSAGE_TIMEOUT_S:
            clients[1].publish(key, b"ping")  # repeatedly: a subscription takes a while to become known
            arrived.wait(0.05)
    finally:
        for client in clients:
            client.close()
    if not arrived.is_set():
        advice = "Check whether a firewall blocks the loopback interface."
        return CheckResult(check, CheckStatus.FAIL, f"no message passed through {endpoint}", advice)
    return CheckResult(check, CheckStatus.OK, f"a message passed through {endpoint}")
