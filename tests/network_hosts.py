"""Hosts of a small network on this machine: network namespaces with addresses of their own, joined by a bridge.

The link of each host can be cut, limited in its rate, and delayed. The kernel limits the rate. Where a link is delayed
or loses frames, they pass a relay, which takes every Ethernet frame from one of two TAP devices and gives it to the
other one later, or never. It is a process of its own: `python tests/network_hosts.py DELAY_S LOST SEED ONE OTHER`.

It takes root and the commands `ip` and `tc`. The network has no way out; this machine is in it too, at `Network.HERE`.
"""

import contextlib
import fcntl
import heapq
import itertools
import os
import random
import select
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

_SUBNET = "10.77.0"
_TUNSETIFF, _TAP_WITHOUT_HEADER = 0x400454CA, 0x0002 | 0x1000
_LARGEST_FRAME = 65536
_NODE_WITHIN_S = 120.0
_BURST_BYTES, _QUEUE_MS = 32 * 1024, 400  # of a limited link


def missing() -> str | None:
    """Return why hosts cannot be made here; None: they can."""
    if os.geteuid() != 0:
        return "network namespaces take root"
    if lacking := [name for name in ("ip", "tc") if shutil.which(name) is None]:
        return f"network namespaces take the command {lacking[0]}, which is not there"
    tried = subprocess.run(["ip", "netns", "add", name := f"zsdist-{os.getpid()}-try"], capture_output=True, text=True)
    if tried.returncode:
        return f"network namespaces cannot be made: {tried.stderr.strip()}"
    subprocess.run(["ip", "netns", "del", name], check=True)
    return None


class Network:
    """Hosts by their names, joined at full speed until a link is changed.

    Args:
        names: names of the hosts, of letters.

    Raises:
        subprocess.CalledProcessError: a namespace or a device cannot be made.
    """

    HERE = f"{_SUBNET}.254"

    def __init__(self, names: Iterable[str]) -> None:
        self._prefix = f"zs{os.getpid()}"
        self._numbers = {name: number for number, name in enumerate(names, 1)}
        self._relays: dict[str, subprocess.Popen[bytes]] = {}
        try:
            self._make(self._space("middle"))
            self._on("middle", "ip link add bridge type bridge")
            self._on("middle", "ip link set bridge up")
            for name in self._numbers:
                self._make(self._space(name))
                link = f"ip link add {self._plug(name)} type veth peer name eth0 netns {self._space(name)}"
                self._on("middle", link)
                self._on("middle", f"ip link set {self._plug(name)} master bridge up")
                self._on(name, f"ip addr add {self.address(name)}/24 dev eth0")
                self._on(name, "ip link set eth0 up")
            here = f"{self._prefix}h"
            _run(f"ip link add {here} type veth peer name here netns {self._space('middle')}")
            self._on("middle", "ip link set here master bridge up")
            _run(f"ip addr add {self.HERE}/24 dev {here}")
            _run(f"ip link set {here} up")
        except BaseException:
            self.close()
            raise

    def address(self, name: str) -> str:
        """Return the address of a host."""
        return f"{_SUBNET}.{self._numbers[name]}"

    def command(self, name: str, words: Sequence[str]) -> list[str]:
        """Return the command that becomes another one on a host, which has its name."""
        named = ["unshare", "--uts", "sh", "-c", 'echo "$0" > /proc/sys/kernel/hostname && exec "$@"', name]
        return ["ip", "netns", "exec", self._space(name), *named, *words]

    def cut(self, name: str) -> None:
        """Take the host's plug out; what it sends and what is sent to it is lost, and nobody is told."""
        self._on("middle", f"ip link set {self._plug(name)} nomaster")

    def mend(self, name: str) -> None:
        """Put the plug of a host in again, without the delay that its link had."""
        self._end_relay(name)
        self._on("middle", f"ip link set {self._plug(name)} master bridge")

    def limit(self, name: str, bits_per_s: float) -> None:
        """Limit the rate of a host's link in each direction, from now on."""
        queue = f"root tbf rate {bits_per_s:.0f} burst {_BURST_BYTES} latency {_QUEUE_MS}ms"
        self._on(name, f"tc qdisc replace dev eth0 {queue}")
        self._on("middle", f"tc qdisc replace dev {self._plug(name)} {queue}")

    def delay(self, name: str, seconds: float, lost: float = 0.0, seed: int = 0) -> None:
        """Delay what a host sends and receives, until `mend`.

        Args:
            name: name of the host.
            seconds: delay in each direction.
            lost: share of the frames that are lost.
            seed: seed of the choice of the lost frames.
        """
        self._end_relay(name)
        number = self._numbers[name]
        for side in ("a", "b"):
            self._on("middle", f"ip tuntap add dev {side}{number} mode tap")
            self._on("middle", f"ip link set {side}{number} up")
        self._on("middle", f"ip link add bridge{number} type bridge")
        self._on("middle", f"ip link set bridge{number} up")
        relay = [sys.executable, __file__, str(seconds), str(lost), str(seed), f"a{number}", f"b{number}"]
        self._relays[name] = subprocess.Popen(self.command("middle", relay), stdout=subprocess.PIPE)
        assert self._relays[name].stdout is not None and self._relays[name].stdout.readline(), "the relay has ended"
        self._on("middle", f"ip link set a{number} master bridge{number}")
        self._on("middle", f"ip link set b{number} master bridge")
        self._on("middle", f"ip link set {self._plug(name)} master bridge{number}")

    def kill(self, name: str) -> None:
        """Kill all processes of a host at once, as a loss of power does."""
        found = subprocess.run(["ip", "netns", "pids", self._space(name)], capture_output=True, text=True, check=False)
        for pid in found.stdout.split():
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(pid), signal.SIGKILL)

    def close(self) -> None:
        """Kill all processes of all hosts, and remove the network."""
        for relay in self._relays.values():
            relay.kill()
            relay.wait()
        for name in (*self._numbers, "middle"):
            self.kill(name)
            subprocess.run(["ip", "netns", "del", self._space(name)], capture_output=True, check=False)

    def _end_relay(self, name: str) -> None:
        if (relay := self._relays.pop(name, None)) is None:
            return
        relay.kill()
        relay.wait()
        for device in (f"a{self._numbers[name]}", f"b{self._numbers[name]}", f"bridge{self._numbers[name]}"):
            self._on("middle", f"ip link del {device}")

    def _make(self, space: str) -> None:
        _run(f"ip netns add {space}")
        _run(f"ip -n {space} link set lo up")

    def _on(self, name: str, command: str) -> None:
        _run(f"ip netns exec {self._space(name)} {command}")

    def _space(self, name: str) -> str:
        return f"{self._prefix}-{name}"

    def _plug(self, name: str) -> str:
        return f"plug{self._numbers[name]}"


def _run(command: str) -> None:
    subprocess.run(command.split(), check=True, capture_output=True)


class RayHosts:
    """Ray cluster with a node on each of some hosts of a network, which asks for a token.

    Args:
        network: network.
        cores: number of Ray's cores on each host, by name; the first one is the head.
        folder: folder for Ray's temporary files, with a short name.
        environment: environment of all its processes, the token included.

    Attributes:
        address: address of the head.
    """

    def __init__(
        self, network: Network, cores: Mapping[str, int], folder: Path, environment: Mapping[str, str]
    ) -> None:
        self._network, self._cores, self._folder, self._environment = network, cores, folder, dict(environment)
        self._nodes: dict[str, subprocess.Popen[bytes]] = {}
        self._head = next(iter(cores))
        self.address = f"{network.address(self._head)}:6379"
        self.start(self._head)

    def start(self, name: str) -> None:
        """Start the node of a host, and wait until it is one."""
        own = f"--node-ip-address={self._network.address(name)}"
        role = ["--head", "--port=6379", "--include-dashboard=false", f"--temp-dir={self._folder}"]
        words = ["start", *(role if name == self._head else [f"--address={self.address}"]), own, "--block"]
        words += [f"--num-cpus={self._cores[name]}", f"--object-store-memory={80 * 2**20}"]
        command = self._network.command(name, [sys.executable, "-m", "ray.scripts.scripts", *words])
        with (self._folder.parent / f"{name}.log").open("ab") as log:
            self._nodes[name] = subprocess.Popen(
                command, env=self._environment, stdout=log, stderr=log, stdin=subprocess.DEVNULL, start_new_session=True
            )
        end_s = time.monotonic() + _NODE_WITHIN_S
        while "Ray runtime started" not in self.said(name):
            assert time.monotonic() < end_s and self.runs(name), (
                f"the node of {name} has not started: {self.said(name)}"
            )
            time.sleep(0.1)

    def said(self, name: str) -> str:
        """Return what the node of a host has printed."""
        return (self._folder.parent / f"{name}.log").read_text(errors="replace")

    def runs(self, name: str) -> bool:
        """Return whether the node of a host has not ended."""
        return self._nodes[name].poll() is None


def _relay(delay_s: float, lost: float, seed: int, names: Sequence[str]) -> None:
    """Pass frames between two TAP devices, each after a delay, some never."""
    devices = []
    for name in names:
        devices.append(os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK))
        fcntl.ioctl(devices[-1], _TUNSETIFF, struct.pack("16sH", name.encode(), _TAP_WITHOUT_HEADER))
    other = {devices[0]: devices[1], devices[1]: devices[0]}
    chance, numbers = random.Random(seed), itertools.count()
    waiting: list[tuple[float, int, int, bytes]] = []
    print("ready", flush=True)
    while True:
        patience_s = max(waiting[0][0] - time.monotonic(), 0.0) if waiting else None
        for device in select.select(devices, [], [], patience_s)[0]:
            with contextlib.suppress(BlockingIOError):
                for _ in range(64):
                    frame = os.read(device, _LARGEST_FRAME)
                    if chance.random() >= lost:
                        heapq.heappush(waiting, (time.monotonic() + delay_s, next(numbers), other[device], frame))
        while waiting and waiting[0][0] <= time.monotonic():
            _, _, device, frame = heapq.heappop(waiting)
            with contextlib.suppress(OSError):  # a full queue loses it
                os.write(device, frame)


if __name__ == "__main__":
    _relay(float(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])
