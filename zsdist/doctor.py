"""`python -m zsdist.doctor`: checks this machine and a cluster address, says what is wrong and what to do."""

import argparse
import importlib.metadata
import json
import os
import shutil
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from rich.console import Console

from zsdist.common import cli
from zsdist.config import Config
from zsdist.errors import TransportError, WeightsError

if TYPE_CHECKING:
    from zsdist.transport.zenoh import ZenohTransport

CORES, MEMORY_GIB, DISK_GIB = 2, 4.0, 2.0  # with less, the default run is slow or fails
CONNECT_TIMEOUT_S = 3.0
RENEW_DAYS = 30  # certificates that are valid for less are warned of
TLS_ENDPOINT = "tls/127.0.0.1:7447"  # to try certificates out, or the next free port
RAY_PORT, RAY_CLIENT_PORT = 6379, 10001
COLOURS = {"ok": "green", "warn": "yellow", "fail": "red"}


class CheckStatus(StrEnum):
    """How a check came out; `WARN`: it works, with a restriction."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True)
class CheckResult:
    """One check: what was found, and what to do where that is not well."""

    check: str
    verdict: CheckStatus
    found: str
    advice: str = ""


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = cli.Parser(prog="zsdist.doctor", description=__doc__)
    parser.add_argument("--address", metavar="RAY", help="also check this Ray cluster: HOST:PORT or auto")
    parser.add_argument("--endpoint", help="of the hub on that cluster (transport.endpoint)")
    parser.add_argument("--tls", type=Path, metavar="DIR", help="also check these certificates (transport.tls)")
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")
    return parser


def main(options: argparse.Namespace) -> int:
    """Runs all checks; 1 where one of them failed."""
    findings, console = [], Console()
    for finding in examine(options.address, options.endpoint, options.tls):
        findings.append(finding)
        if not options.json:
            colour = COLOURS[finding.verdict]
            console.print(f"[{colour}]{finding.verdict:4}[/{colour}] {finding.check}: {finding.found}", highlight=False)
            if finding.advice:
                console.print(f"     {finding.advice}", highlight=False)
    failed = any(finding.verdict is CheckStatus.FAIL for finding in findings)
    if options.json:
        print(json.dumps({"ok": not failed, "checks": [asdict(finding) for finding in findings]}, indent=1))
    return 1 if failed else 0


def examine(address: str | None, endpoint: str | None, tls: Path | None = None) -> Iterator[CheckResult]:
    """All checks, one after another; what a check did not expect is a failure of that check, not of the command."""
    yield check_python()
    yield from check_packages()
    yield from check_machine()
    for name, check in (("camera", check_camera), ("vision", check_vision), ("zenoh", check_zenoh), ("ray", check_ray)):
        yield guarded(name, check)
    if address is not None:
        yield check_address(address)
    if address is not None or endpoint is not None:
        yield check_endpoint(Config().transport.endpoint if endpoint is None else endpoint)
    if tls is not None:
        yield from check_certificates(tls, endpoint)


def guarded(name: str, check: Callable[[], CheckResult]) -> CheckResult:
    """A check's finding; a failure with the exception's own words where it raises one."""
    try:
        return check()
    except Exception as error:  # the point of a doctor is to survive any illness
        return CheckResult(
            name, CheckStatus.FAIL, f"{type(error).__name__}: {' '.join(str(error).split())}", "Run make install."
        )


def check_python(version: tuple[int, ...] = sys.version_info[:3]) -> CheckResult:
    """The interpreter against what the package requires."""
    text = ".".join(str(part) for part in version)
    try:
        required = importlib.metadata.metadata("zsdist")["Requires-Python"]
    except importlib.metadata.PackageNotFoundError:
        return CheckResult("python", CheckStatus.FAIL, f"{text}; zsdist itself is not installed", "Run make install.")
    if not SpecifierSet(required).contains(text):
        return CheckResult("python", CheckStatus.FAIL, f"{text}; allowed is {required}", "Install with Python 3.11.")
    return CheckResult("python", CheckStatus.OK, f"{text} at {sys.executable}")


def check_packages(requirements: list[str] | None = None) -> Iterator[CheckResult]:
    """Every required package against its range; one line where all is well."""
    if requirements is None:
        try:
            requirements = importlib.metadata.requires("zsdist") or []
        except importlib.metadata.PackageNotFoundError:
            return  # said by `check_python`
    needed = [requirement for text in requirements if (requirement := Requirement(text)).marker is None]
    well = True
    for requirement in needed:
        try:
            version = importlib.metadata.version(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            version = "missing"
        if version == "missing" or not requirement.specifier.contains(version):
            well = False
            found = f"{version}; allowed is {requirement.specifier}"
            yield CheckResult(f"package {requirement.name}", CheckStatus.FAIL, found, "Run make install.")
    if well:
        yield CheckResult("packages", CheckStatus.OK, f"{len(needed)} packages within their ranges")


def check_machine() -> Iterator[CheckResult]:
    """Cores, memory and disk."""
    cores = os.cpu_count() or 1
    yield enough("cores", cores, CORES, "", "Expect the default run to take longer.")
    memory_gib = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    yield enough("memory", memory_gib, MEMORY_GIB, " GiB", "Use fewer actors: --actors 1.")
    free_gib = shutil.disk_usage(Path.cwd()).free / 2**30
    yield enough("disk", free_gib, DISK_GIB, " GiB free here", "Make room, or set --run-dir to another disk.")


def enough(check: str, found: float, wanted: float, unit: str, advice: str) -> CheckResult:
    """A warning where there is less than wanted."""
    if found >= wanted:
        return CheckResult(check, CheckStatus.OK, f"{found:.3g}{unit}")
    return CheckResult(check, CheckStatus.WARN, f"{found:.3g}{unit}; {wanted:g} are recommended", advice)


def check_camera() -> CheckResult:
    """Renders one picture of a scene."""
    from zsdist.sim.camera import make_camera
    from zsdist.sim.scenes import families

    config, scene = Config().camera, families.draw("iid", "train", 0)
    camera = make_camera(config)
    camera.render(scene, scene.start.pose)
    began_s = time.perf_counter()
    image = camera.render(scene, scene.start.pose)
    taken_ms = 1000 * (time.perf_counter() - began_s)
    if image.std() == 0:
        return CheckResult(
            "camera", CheckStatus.FAIL, f"{config.back_end}: the picture is empty", "Try the other back end."
        )
    return CheckResult("camera", CheckStatus.OK, f"{config.back_end}, {config.size_px} px in {taken_ms:.1f} ms")


def check_vision() -> CheckResult:
    """Every file of the shipped weights, one reading by encoder and head, one by the student, one look for words."""
    from zsdist.vision import weights_folder
    from zsdist.vision.visual_act import VisualAct

    config = Config()
    image = np.zeros((1, config.camera.size_px, config.camera.size_px, 3), dtype=np.uint8)
    optional = (weights_folder.STUDENT_FILE, weights_folder.PROJECTION_FILE, weights_folder.VOCABULARY_FILE)
    found = []
    try:
        weights = weights_folder.read(weights_folder.SHIPPED)
        missing = [file for file in optional if not weights.has(file)]
        for file in weights.metadata["files"]:
            weights.content(file)
        for network in ("head", "student"):
            if network == "student" and weights_folder.STUDENT_FILE in missing:
                continue
            model = VisualAct.load(config.vision.model_copy(update={"network": network}), config.camera)
            model.read(image)
            began_s = time.perf_counter()
            model.read(image)
            taken_ms = 1000 * (time.perf_counter() - began_s)
            found.append(f"{model.encoder_name}, weights {model.weights_sha256[:12]}, {taken_ms:.1f} ms")
            if network == "head" and weights_folder.PROJECTION_FILE not in missing:
                model.observe(image)
    except WeightsError as error:
        advice = "Install the package whole (make install), or make weights: python -m zsdist.pretrain."
        return CheckResult("vision", CheckStatus.FAIL, str(error), advice)
    if missing:
        text = "; ".join([*found, f"no {', '.join(missing)}"])
        return CheckResult(
            "vision", CheckStatus.WARN, text, "What needs them is refused; python -m zsdist.pretrain makes them."
        )
    return CheckResult("vision", CheckStatus.OK, "; ".join(found))


def check_zenoh() -> CheckResult:
    """A hub, two clients, and one message there and back."""
    from zsdist.transport.zenoh import ZenohHub, ZenohTransport

    with ZenohHub(Config().transport.endpoint) as hub:
        return _message_through("zenoh", hub.endpoint, [ZenohTransport(hub.endpoint) for _ in range(2)])


def check_certificates(folder: Path, endpoint: str | None) -> Iterator[CheckResult]:
    """Every certificate in a folder; where the hub's is among them, its host and a message over TLS."""
    from zsdist.roles import permissions
    from zsdist.transport.certificates import AUTHORITY, Identity
    from zsdist.transport.zenoh import ZenohHub, ZenohTransport

    names = sorted(path.stem for path in folder.glob("*.pem") if path.stem != AUTHORITY)
    identities = {}
    for name in names:
        check, renew = (
            f"certificate {name}",
            f"Remove {name}.pem and {name}.key, then run zsdist.certs {folder}.",
        )
        try:
            identity = identities[name] = Identity.load(folder, name)
        except TransportError as error:
            yield CheckResult(check, CheckStatus.FAIL, str(error), renew)
            continue
        if identity.key.stat().st_mode & 0o007:
            yield CheckResult(
                check, CheckStatus.WARN, f"everybody here may read {identity.key}", f"chmod 600 {identity.key}"
            )
        elif (days := identity.days_left()) < RENEW_DAYS:
            yield CheckResult(check, CheckStatus.WARN, f"valid for another {days} days", renew)
        else:
            yield CheckResult(check, CheckStatus.OK, f"valid for another {days} days")
    if not names:
        yield CheckResult(
            f"certificates {folder}", CheckStatus.FAIL, "there are none", f"Run python -m zsdist.certs {folder}."
        )
    if permissions.HUB not in identities or permissions.TRUSTED not in identities:
        return  # a machine on which actors drive has no use for them
    hosts, wanted = identities[permissions.HUB].hosts(), host_of(endpoint or Config().transport.endpoint)
    verdict = CheckStatus.OK if wanted in hosts else CheckStatus.FAIL
    advice = "" if wanted in hosts else f"Remove hub.pem and hub.key, and run zsdist.certs with --host {wanted}."
    yield CheckResult("certificate of the hub's host", verdict, f"{wanted}; it is for {', '.join(hosts)}", advice)

    hop = "zenoh over TLS"

    def over_tls() -> CheckResult:
        with ZenohHub(TLS_ENDPOINT, identities[permissions.HUB], permissions.access_list(1)) as hub:
            shown = identities[permissions.TRUSTED]
            return _message_through(hop, hub.endpoint, [ZenohTransport(hub.endpoint, shown) for _ in range(2)])

    yield guarded(hop, over_tls)


def _message_through(check: str, endpoint: str, clients: "list[ZenohTransport]") -> CheckResult:
    """One message from one client to the other, which are closed."""
    from zsdist.transport.base import Mailbox

    arrived, key = threading.Event(), "zsdist/doctor/events"
    try:
        clients[0].subscribe(key, Mailbox(1024, arrived.set))
        began_s = time.perf_counter()
        while not arrived.is_set() and time.perf_counter() - began_s < CONNECT_TIMEOUT_S:
            clients[1].publish(key, b"ping")  # again and again: a subscription takes a while to be known
            arrived.wait(0.05)
    finally:
        for client in clients:
            client.close()
    if not arrived.is_set():
        advice = "Look for a firewall on the loopback interface."
        return CheckResult(check, CheckStatus.FAIL, f"no message came through {endpoint}", advice)
    return CheckResult(check, CheckStatus.OK, f"a message came through {endpoint}")


def check_ray() -> CheckResult:
    """Whether the Ray runner can be imported."""
    from zsdist.run import ray  # noqa: F401 (that it can be imported is what is checked)

    return CheckResult("ray", CheckStatus.OK, f"version {importlib.metadata.version('ray')}")


def check_address(address: str) -> CheckResult:
    """Whether something listens at a Ray address."""
    check = f"cluster {address}"
    place = _current_cluster() if address == "auto" else address
    if place is None:
        return CheckResult(
            check, CheckStatus.FAIL, "no Ray cluster runs on this machine", "Start one: ray start --head."
        )
    port = RAY_CLIENT_PORT if place.startswith("ray://") else RAY_PORT
    host, _, digits = place.removeprefix("ray://").rpartition(":")
    if not digits.isdecimal():
        host, digits = digits, str(port)
    try:
        socket.create_connection((host, int(digits)), timeout=CONNECT_TIMEOUT_S).close()
    except (OSError, OverflowError) as error:
        advice = "Check that the head node runs, and that this port is open between here and there."
        return CheckResult(check, CheckStatus.FAIL, f"{host}:{digits} does not answer: {error}", advice)
    return CheckResult(check, CheckStatus.OK, f"{host}:{digits} answers")


def check_endpoint(endpoint: str) -> CheckResult:
    """Whether the roles of a cluster could reach the hub's endpoint, and nobody else do harm there."""
    check, advice = f"endpoint {endpoint}", "Set transport.endpoint to this machine's address: tls/HOST:7447."
    host = host_of(endpoint)
    if not host:
        return CheckResult(check, CheckStatus.FAIL, "it is not of the form PROTOCOL/HOST:PORT", advice)
    try:
        places = {item[4][0] for item in socket.getaddrinfo(host, None)}
    except OSError as error:
        return CheckResult(check, CheckStatus.FAIL, f"{host} has no address: {error}", advice)
    if any(place.startswith("127.") or place in ("::1", "0.0.0.0", "::") for place in places):
        return CheckResult(check, CheckStatus.FAIL, "other machines cannot reach it", advice)
    if not endpoint.startswith("tls/"):
        return CheckResult(check, CheckStatus.FAIL, "it asks for no certificate, and a run refuses it", advice)
    return CheckResult(check, CheckStatus.OK, f"{', '.join(sorted(places))}; other machines may reach it")


def host_of(endpoint: str) -> str:
    """The host of `PROTOCOL/HOST:PORT`; empty where it is not of that form."""
    return endpoint.partition("/")[2].rpartition(":")[0].strip("[]")


def _current_cluster() -> str | None:
    """Address of the cluster that `auto` means: of the environment, or of the one started here last."""
    if address := os.environ.get("RAY_ADDRESS"):
        return address
    note = Path(tempfile.gettempdir()) / "ray" / "ray_current_cluster"
    return note.read_text().strip() or None if note.is_file() else None


if __name__ == "__main__":
    cli.execute(main, make_parser())
