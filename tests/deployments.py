"""Shipped files of `deploy/`, read for tests: manifests as Kubernetes gets them, and the run that each file starts."""

import functools
import re
import shlex
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

import zsdist
from zsdist import config, launch
from zsdist.common import cli
from zsdist.config import Config

ROOT = Path(__file__).parents[1]
DEPLOY = ROOT / "deploy"
KUBERNETES = DEPLOY / "kubernetes"
IMAGES = {f"zsdist:{zsdist.__version__}", f"zsdist-gpu:{zsdist.__version__}"}
SIZES = ("base", "small", "large", "gpu")  # of runs; `interactive` has a cluster alone
MEMORY_BYTES = {"Mi": 2**20, "Gi": 2**30}
Manifest = dict[str, Any]


@functools.cache
def rendered(name: str) -> tuple[Manifest, ...]:
    """Return the manifests that `kubectl apply -k` would apply."""
    if shutil.which("kubectl") is None:
        pytest.skip("kubectl, which has kustomize, is not on the path")
    command = ["kubectl", "kustomize", str(KUBERNETES / name)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return tuple(yaml.safe_load_all(done.stdout))


def of_kind(manifests: tuple[Manifest, ...], kind: str) -> list[Manifest]:
    """Return the manifests of a kind."""
    return [manifest for manifest in manifests if manifest["kind"] == kind]


def cluster(name: str) -> Manifest:
    """Return the specification of the Ray cluster of a kustomization."""
    jobs = of_kind(rendered(name), "RayJob")
    return jobs[0]["spec"]["rayClusterSpec"] if jobs else of_kind(rendered(name), "RayCluster")[0]["spec"]


def groups(name: str) -> list[Manifest]:
    """Return the groups of pods of a kustomization, the head first."""
    return [cluster(name)["headGroupSpec"], *cluster(name)["workerGroupSpecs"]]


def pods(name: str) -> list[Manifest]:
    """Return the templates of all pods: those of the cluster, the submitter's, and those of deployments."""
    templates = [group["template"] for group in groups(name)]
    templates += [job["spec"]["submitterPodTemplate"] for job in of_kind(rendered(name), "RayJob")]
    return templates + [deployment["spec"]["template"] for deployment in of_kind(rendered(name), "Deployment")]


def launched(command: str) -> Config:
    """Return the configuration of the run that a command line of `zsdist.launch` starts, as the launcher reads it."""
    words = shlex.split(re.sub(r"\\\n", " ", command))
    words = words[words.index("zsdist.launch") + 1 :]
    options = launch.make_parser().parse_args(words)
    return config.load(ROOT / "configs" / Path(options.config).name, cli.overrides(options))


def memory_bytes(text: str) -> int:
    """Return an amount of memory of Kubernetes in bytes."""
    return int(text[:-2]) * MEMORY_BYTES[text[-2:]]
