import copy
import re
from pathlib import Path

import pytest
import yaml
from ray.autoscaler._private.util import prepare_config, validate_config

import zsdist

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"
IMAGE = f"zsdist:{zsdist.__version__}"
RAY_CLUSTER = yaml.safe_load((DEPLOY / "ray-cluster.yaml").read_text())
MANIFEST, SERVICE, POLICY = yaml.safe_load_all((DEPLOY / "kuberay.yaml").read_text())


def test_ray_cluster_file_passes_rays_own_schema():
    validate_config(prepare_config(copy.deepcopy(RAY_CLUSTER)))


def test_rays_schema_refuses_an_unknown_key():
    with pytest.raises(Exception, match="sneaky"):
        validate_config({**prepare_config(copy.deepcopy(RAY_CLUSTER)), "sneaky": 1})


def test_ray_cluster_has_a_head_and_workers_up_to_its_limit():
    assert RAY_CLUSTER["provider"]["head_ip"] not in RAY_CLUSTER["provider"]["worker_ips"]
    assert len(RAY_CLUSTER["provider"]["worker_ips"]) == RAY_CLUSTER["max_workers"]
    assert RAY_CLUSTER["docker"]["image"] == IMAGE


def containers() -> list[dict]:
    groups = [MANIFEST["spec"]["headGroupSpec"], *MANIFEST["spec"]["workerGroupSpecs"]]
    return [container for group in groups for container in group["template"]["spec"]["containers"]]


def test_kuberay_manifest_has_the_fields_that_the_operator_requires():
    assert (MANIFEST["apiVersion"], MANIFEST["kind"]) == ("ray.io/v1", "RayCluster")
    head, *_ = containers()
    assert "rayStartParams" in MANIFEST["spec"]["headGroupSpec"]
    assert {"gcs-server", "client", "zenoh"} <= {port["name"] for port in head["ports"]}
    for group in MANIFEST["spec"]["workerGroupSpecs"]:
        assert group["minReplicas"] <= group["replicas"] <= group["maxReplicas"] and group["groupName"]


def test_kuberay_runs_the_tested_ray_on_our_image():
    assert f"ray=={MANIFEST['spec']['rayVersion']}\n" in (ROOT / "constraints.txt").read_text()
    assert {container["image"] for container in containers()} == {IMAGE}


def test_kuberay_pods_do_not_run_as_root_and_have_memory_limits():
    for group in (MANIFEST["spec"]["headGroupSpec"], *MANIFEST["spec"]["workerGroupSpecs"]):
        assert group["template"]["spec"]["securityContext"]["runAsNonRoot"]
    for container in containers():
        assert container["resources"]["limits"]["memory"]
        assert not container["securityContext"]["allowPrivilegeEscalation"]


def test_network_policy_admits_only_the_cluster():
    assert POLICY["spec"]["podSelector"]["matchLabels"] == {"ray.io/cluster": MANIFEST["metadata"]["name"]}
    assert all("podSelector" in peer for rule in POLICY["spec"]["ingress"] for peer in rule["from"])


def test_the_hubs_name_resolves_to_the_head_pod_only():
    spec = MANIFEST["spec"]["headGroupSpec"]["template"]["spec"]
    name = f"{spec['hostname']}.{spec['subdomain']}"
    assert spec["subdomain"] == SERVICE["metadata"]["name"] and SERVICE["spec"]["clusterIP"] == "None"
    assert SERVICE["spec"]["selector"]["ray.io/node-type"] == "head"
    readme = (DEPLOY / "README.md").read_text()
    assert f"--host {name} " in readme and f"tls/{name}:7447" in readme


def test_workers_hold_only_the_keys_of_actors():
    readme = (DEPLOY / "README.md").read_text()
    secrets = dict(re.findall(r"secret generic (\S+) \$\(files (.*)\)", readme))
    assert secrets["zsdist-tls-actors"].split() == ["tls/ca.pem", "tls/actor-*"]
    assert not any("ca.key" in files or "ca.*" in files for files in secrets.values())
    head, *workers = [MANIFEST["spec"]["headGroupSpec"], *MANIFEST["spec"]["workerGroupSpecs"]]
    for group, secret in ((head, "zsdist-tls-head"), *((worker, "zsdist-tls-actors") for worker in workers)):
        spec = group["template"]["spec"]
        (volume,) = [volume for volume in spec["volumes"] if "secret" in volume]
        assert volume["secret"]["secretName"] == secret in secrets
        assert any(
            mount["name"] == volume["name"] and mount["readOnly"] for mount in spec["containers"][0]["volumeMounts"]
        )


def dockerfile() -> list[tuple[str, str]]:
    text = re.sub(r"\\\n", " ", (DEPLOY / "Dockerfile").read_text())
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    return [tuple(line.split(maxsplit=1)) for line in lines]


def test_dockerfile_is_python_3_11_and_ends_as_an_unprivileged_user():
    instructions = dockerfile()
    assert instructions[0] == ("FROM", "python:3.11-slim")
    assert {name for name, _ in instructions} <= {"FROM", "ARG", "ENV", "RUN", "WORKDIR", "COPY", "USER", "CMD"}
    users = [argument for name, argument in instructions if name == "USER"]
    assert users[-1] not in ("root", "0")
    assert max(i for i, (name, _) in enumerate(instructions) if name == "CMD") > instructions.index(("USER", users[-1]))


def test_dockerfile_copies_only_existing_files():
    for name, argument in dockerfile():
        if name == "COPY":
            for source in argument.split()[:-1]:
                assert (ROOT / source).exists(), source


def test_readme_names_only_existing_files():
    for name in re.findall(r"(?:deploy|configs)/[\w.-]+", (DEPLOY / "README.md").read_text()):
        assert (ROOT / name).exists(), name
