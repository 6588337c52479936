"""Manifests of Kubernetes: each object is one that KubeRay and Kubernetes take, and they fit each other."""

import copy
import json
import re
import subprocess
from pathlib import Path

import kubernetes_shapes
import pytest
import ray
import yaml
from deployments import DEPLOY, IMAGES, KUBERNETES, ROOT, SIZES, cluster, groups, of_kind, pods, rendered
from ray._private import ray_constants

import zsdist
from zsdist import monitor
from zsdist.telemetry import prometheus

CLUSTERS = (*SIZES, "interactive")
ALL = (*CLUSTERS, "monitoring")


def containers(name):
    return [container for pod in pods(name) for container in pod["spec"]["containers"]]


def matches(selector, pod):
    return selector["matchLabels"].items() <= pod["metadata"]["labels"].items()


@pytest.mark.parametrize("name", ALL)
def test_every_object_has_only_fields_that_there_are(name):
    assert [line for manifest in rendered(name) for line in kubernetes_shapes.problems(manifest)] == []


@pytest.mark.parametrize(
    ("where", "value"),
    [
        ("spec.rayClusterSpec.headGroupSpec.template.spec.containers.0.volumeMount", []),
        ("spec.rayClusterSpec.authOption", {}),
        ("spec.backoffLimit", "10"),
        ("spec.rayClusterSpec.headGroupSpec.rayStartParams.num-cpus", 6),
        ("spec.rayClusterSpec.workerGroupSpecs.0.template.spec.runAsUser", 1000),
    ],
)
def test_a_field_that_is_misspelt_at_the_wrong_place_or_of_another_type_is_noticed(where, value):
    (job,) = copy.deepcopy(of_kind(rendered("base"), "RayJob"))
    *parents, last = [int(part) if part.isdecimal() else part for part in where.split(".")]
    place = job
    for part in parents:
        place = place[part]
    place[last] = value
    assert len(kubernetes_shapes.problems(job)) == 1


@pytest.mark.parametrize("name", CLUSTERS)
def test_the_cluster_asks_for_a_token_and_runs_the_tested_ray_on_our_images(name):
    spec = cluster(name)
    assert spec["authOptions"] == {"mode": "token"}
    assert f"ray=={spec['rayVersion']}\n" in (ROOT / "constraints.txt").read_text()
    assert {container["image"] for container in containers(name)} <= IMAGES


@pytest.mark.parametrize("size", SIZES)
def test_a_run_resumes_by_itself_from_a_volume_that_outlives_its_cluster(size):
    (job,) = of_kind(rendered(size), "RayJob")
    command = job["spec"]["entrypoint"]
    assert "--auto-resume" in command and job["spec"]["backoffLimit"] > 0
    assert job["spec"]["submissionMode"] == "K8sJobMode" and job["spec"]["submitterConfig"]["backoffLimit"] > 0
    (claim,) = of_kind(rendered(size), "PersistentVolumeClaim")
    head = groups(size)[0]["template"]["spec"]
    (volume,) = [volume for volume in head["volumes"] if "persistentVolumeClaim" in volume]
    assert volume["persistentVolumeClaim"]["claimName"] == claim["metadata"]["name"]
    (mount,) = [mount for mount in head["containers"][0]["volumeMounts"] if mount["name"] == volume["name"]]
    assert f"--run-dir {mount['mountPath']}/" in command and not mount.get("readOnly")


@pytest.mark.parametrize("name", CLUSTERS)
def test_pods_are_admitted_by_the_restricted_profile_of_kubernetes_and_have_memory_limits(name):
    user = re.search(r"^USER (\d+)$", (DEPLOY / "Dockerfile").read_text(), re.MULTILINE)
    for pod in pods(name):
        context = pod["spec"]["securityContext"]
        assert context["runAsNonRoot"] and context["seccompProfile"] == {"type": "RuntimeDefault"}
        assert context["runAsUser"] == int(user.group(1))
        kinds = {kind for volume in pod["spec"].get("volumes", ()) for kind in volume}
        assert kinds <= {"name", "secret", "emptyDir", "persistentVolumeClaim"}
    for container in containers(name):
        assert container["securityContext"] == {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}}
        assert container["resources"]["limits"]["memory"] == container["resources"]["requests"]["memory"]


@pytest.mark.parametrize("name", CLUSTERS)
def test_probes_need_no_program_and_no_token_and_ask_what_this_ray_answers(name):
    agent = Path(ray.__file__).parent / "dashboard"
    routes = "".join(path.read_text() for path in agent.glob("modules/**/*agent.py"))
    public = re.search(r"PUBLIC_EXACT_PATHS = \[(.*?)\]", (agent / "http_server_agent.py").read_text(), re.DOTALL)
    for group in groups(name):
        (container,) = group["template"]["spec"]["containers"]
        for probe in (container["livenessProbe"], container["readinessProbe"]):
            asked = probe["httpGet"]
            assert asked["port"] == ray_constants.DEFAULT_DASHBOARD_AGENT_LISTEN_PORT
            assert f'@routes.get("{asked["path"]}")' in routes
            assert f'"{asked["path"]}"' in public.group(1)


@pytest.mark.parametrize("name", CLUSTERS)
def test_numbers_of_pods_are_within_their_limits(name):
    for group in cluster(name)["workerGroupSpecs"]:
        assert group["minReplicas"] <= group["replicas"] <= group["maxReplicas"]


@pytest.mark.parametrize("name", CLUSTERS)
def test_the_hubs_name_resolves_to_the_head_alone(name):
    (service,) = of_kind(rendered(name), "Service")
    head, *workers = [group["template"] for group in groups(name)]
    assert service["spec"]["clusterIP"] == "None" and service["metadata"]["name"] == head["spec"]["subdomain"]
    selector = {"matchLabels": service["spec"]["selector"]}
    assert matches(selector, head) and not any(matches(selector, worker) for worker in workers)
    hub = f"tls/{head['spec']['hostname']}.{head['spec']['subdomain']}:7447"
    commands = [job["spec"]["entrypoint"] for job in of_kind(rendered(name), "RayJob")]
    assert all(f"transport.endpoint={hub}" in command.split() for command in commands)
    (watcher,) = of_kind(rendered(name), "Deployment")
    assert hub in watcher["spec"]["template"]["spec"]["containers"][0]["args"]
    assert f"--host {hub.split('/')[1].split(':')[0]} " in (ROOT / "docs" / "kubernetes.md").read_text()


@pytest.mark.parametrize("name", CLUSTERS)
def test_the_network_admits_only_who_has_to_reach_a_port(name):
    policies = of_kind(rendered(name), "NetworkPolicy")
    for pod in pods(name):
        if pod["metadata"]["labels"]["app.kubernetes.io/name"] != "zsdist-submitter":  # it has no port
            assert sum(matches(policy["spec"]["podSelector"], pod) for policy in policies) == 1
    (ray_policy,) = [policy for policy in policies if policy["metadata"]["name"] == "zsdist"]
    own = ray_policy["spec"]["podSelector"]
    for rule in ray_policy["spec"]["ingress"]:
        inside = all(peer == {"podSelector": own} for peer in rule["from"])
        assert inside or {port["port"] for port in rule["ports"]} <= {7447, 8265}
        assert all("podSelector" in peer for peer in rule["from"])


@pytest.mark.parametrize("name", CLUSTERS)
def test_the_head_is_never_evicted_and_workers_one_by_one(name):
    budgets = of_kind(rendered(name), "PodDisruptionBudget")
    templates = [group["template"] for group in groups(name)]
    for budget in budgets:
        # A budget for pods of a custom resource may state this number alone.
        assert budget["spec"].keys() == {"minAvailable", "selector"} and isinstance(budget["spec"]["minAvailable"], int)
        assert any(matches(budget["spec"]["selector"], template) for template in templates)
    assert any(matches(budget["spec"]["selector"], templates[0]) for budget in budgets)


@pytest.mark.parametrize("name", CLUSTERS)
def test_each_pod_holds_only_the_keys_of_its_roles(name):
    secrets = {"head": "zsdist-tls-head", "actors": "zsdist-tls-actors", "learners": "zsdist-tls-learner"}
    page = (ROOT / "docs" / "kubernetes.md").read_text()
    for group in groups(name):
        spec, labels = group["template"]["spec"], group["template"]["metadata"]["labels"]
        (volume,) = [volume for volume in spec["volumes"] if "secret" in volume]
        assert volume["secret"]["secretName"] == secrets[labels["app.kubernetes.io/component"]]
        assert volume["secret"]["secretName"].removeprefix("zsdist-tls-") in page
        (mount,) = [mount for mount in spec["containers"][0]["volumeMounts"] if mount["name"] == volume["name"]]
        assert mount["readOnly"] and mount["mountPath"] == "/home/zsdist/tls"


def test_the_monitor_serves_figures_where_the_prometheus_operator_reads_them():
    (deployment,) = of_kind(rendered("base"), "Deployment")
    pod = deployment["spec"]["template"]
    (container,) = pod["spec"]["containers"]
    options = monitor.make_parser().parse_args(container["args"])
    assert container["command"] == ["python", "-m", "zsdist.monitor"] and options.prometheus.host == "0.0.0.0"
    (port,) = container["ports"]
    assert port["containerPort"] == options.prometheus.port
    (pod_monitor,) = of_kind(rendered("monitoring"), "PodMonitor")
    (endpoint,) = pod_monitor["spec"]["podMetricsEndpoints"]
    assert endpoint["port"] == port["name"] and endpoint["path"] == f"/{prometheus.PAGE}"
    assert matches(pod_monitor["spec"]["selector"], pod)
    assert container["livenessProbe"]["httpGet"] == {"path": endpoint["path"], "port": port["name"]}


def test_every_figure_of_the_dashboard_is_one_that_a_role_reports():
    dashboard = json.loads((KUBERNETES / "monitoring" / "dashboard.json").read_text())
    queries = "\n".join(target["expr"] for panel in dashboard["panels"] for target in panel["targets"])
    sources = "".join(path.read_text() for path in Path(zsdist.__file__).parent.rglob("*.py"))
    own = set(re.findall(r'"(zsdist_\w+)"', (ROOT / "zsdist" / "telemetry" / "prometheus.py").read_text()))
    for name in sorted(set(re.findall(r"zsdist_\w+", queries))):
        counter = name.endswith("_total")
        plain = name.removesuffix("_total")
        if plain in own:
            continue
        field = re.sub(r"_seconds$", "_s", plain).split("_", 2)[2]
        assert f'"{field}"' in sources or f'_{field}"' in sources, f"no role reports {field}"
        assert (field in prometheus.COUNTERS) == counter, f"{name} is {'no ' if counter else 'a '}counter"


def test_the_image_of_another_registry_reaches_every_pod(tmp_path):
    names = ("zsdist", "zsdist-gpu")
    images = [{"name": name, "newName": f"registry.example/{name}", "newTag": "1"} for name in names]
    folder = tmp_path / "mine"
    folder.mkdir()
    base = Path(*[".."] * (len(folder.resolve().parts) - 1), *(KUBERNETES / "gpu").resolve().parts[1:])
    (folder / "kustomization.yaml").write_text(yaml.safe_dump({"resources": [str(base)], "images": images}))
    rendered("base")  # skips where there is no kubectl
    done = subprocess.run(["kubectl", "kustomize", str(folder)], capture_output=True, text=True, timeout=60, check=True)
    found = re.findall(r"image: (\S+)", done.stdout)
    assert len(found) == 5 and set(found) == {f"registry.example/{name}:1" for name in names}


def test_the_versions_of_the_operator_are_named_in_both_places():
    (version,) = re.findall(r"For KubeRay (\S+)\.$", (KUBERNETES / "base" / "kustomization.yaml").read_text(), re.M)
    assert f"KubeRay {version}" in (ROOT / "docs" / "kubernetes.md").read_text()
