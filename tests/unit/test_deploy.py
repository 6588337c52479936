import copy
import re
import sys
from pathlib import Path

import pytest
import ray
import yaml
from ray._private import ray_constants
from ray.autoscaler._private.util import prepare_config, validate_config

import zsdist

sys.path.insert(0, str(Path(__file__).parents[2] / "deploy"))
import slim

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


@pytest.mark.parametrize("container", containers(), ids=lambda container: container["name"])
@pytest.mark.parametrize("probe", ["livenessProbe", "readinessProbe"])
def test_probes_need_no_program_in_the_image_and_ask_what_this_ray_answers(container, probe):
    stated = container[probe]
    assert not {"exec", "grpc", "tcpSocket"} & stated.keys()  # without any, older operators run wget
    assert stated["httpGet"]["port"] == ray_constants.DEFAULT_DASHBOARD_AGENT_LISTEN_PORT
    routes = "".join(path.read_text() for path in Path(ray.__file__).parent.glob("dashboard/modules/**/*agent.py"))
    assert f'@routes.get("{stated["httpGet"]["path"]}")' in routes


def test_the_versions_of_the_operator_are_named_in_both_places():
    (versions,) = re.findall(r"# For KubeRay (\S+ or \S+)\. ", (DEPLOY / "kuberay.yaml").read_text())
    assert f"KubeRay operator, {versions}:" in (DEPLOY / "README.md").read_text()


def test_kuberay_pods_are_admitted_by_the_restricted_profile_of_kubernetes():
    for group in (MANIFEST["spec"]["headGroupSpec"], *MANIFEST["spec"]["workerGroupSpecs"]):
        assert group["template"]["spec"]["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
        volumes = group["template"]["spec"]["volumes"]
        assert {kind for volume in volumes for kind in volume} <= {"name", "secret", "emptyDir"}
    for container in containers():
        assert container["securityContext"]["capabilities"] == {"drop": ["ALL"]}


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
    assert users[-1].isdecimal() and users[-1] != "0"  # runAsNonRoot refuses a name
    assert {MANIFEST["spec"]["headGroupSpec"]["template"]["spec"]["securityContext"]["runAsUser"]} == {int(users[-1])}
    assert max(i for i, (name, _) in enumerate(instructions) if name == "CMD") > instructions.index(("USER", users[-1]))


def test_any_user_of_group_0_may_write_the_home_folder_of_the_image():
    instructions = dockerfile()
    home = next(argument for name, argument in reversed(instructions) if name == "WORKDIR")
    assert any(name == "ENV" and f"HOME={home}" in argument.split() for name, argument in instructions)
    (shared,) = [i for i, (name, argument) in enumerate(instructions) if name == "RUN" and "chmod -R g=u ." in argument]
    assert "chown -R 1000:0 ." in instructions[shared][1] and "mkdir -p runs" in instructions[shared][1]
    assert ("WORKDIR", home) in instructions[:shared]
    assert not any(name in ("COPY", "WORKDIR") for name, _ in instructions[shared:])


def test_dockerfile_copies_only_existing_files():
    for name, argument in dockerfile():
        if name == "COPY":
            for source in argument.split()[:-1]:
                assert (ROOT / source).exists(), source


def test_readme_names_only_existing_files():
    for name in re.findall(r"(?:deploy|configs)/[\w.-]+", (DEPLOY / "README.md").read_text()):
        assert (ROOT / name).exists(), name


def test_what_nothing_reads_is_listed_and_removed(tmp_path):
    for name in (
        "pybullet_data/plane.urdf",
        "torch/test/a",
        "torch/bin/protoc",
        "torch/bin/torch_shm_manager",
        "other/a",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1234")
    found = slim.unread(tmp_path)
    assert [str(path.relative_to(tmp_path)) for path in found] == ["pybullet_data", "torch/bin/protoc", "torch/test"]
    assert sum(map(slim.size, found)) == 12
    for path in found:
        slim.remove(path)
    assert slim.unread(tmp_path) == []
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == ["a", "torch_shm_manager"]
