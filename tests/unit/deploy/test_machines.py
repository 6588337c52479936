"""Files for machines without Kubernetes: Compose, `ray up`, and the service of spare PCs."""

import configparser
import copy
import importlib
import re
import shlex
import shutil
import subprocess

import pytest
import yaml
from deployments import DEPLOY, IMAGES, ROOT
from ray.autoscaler._private.util import prepare_config, validate_config

from zsdist import launch, monitor
from zsdist.wire import keys

COMPOSE = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
SERVICES = COMPOSE["services"]
OURS = {name: service for name, service in SERVICES.items() if service["image"] in IMAGES}
RAY_CLUSTER = yaml.safe_load((DEPLOY / "ray-cluster.yaml").read_text())
# Fields of the Compose specification that a service may have, as far as ours use them.
SERVICE_FIELDS = {
    *("image", "build", "user", "init", "environment", "hostname", "command", "restart", "stop_grace_period"),
    *("secrets", "networks", "shm_size", "cap_drop", "security_opt", "ulimits", "healthcheck", "depends_on"),
    *("volumes", "ports", "profiles", "configs"),
}


def test_compose_has_only_fields_that_there_are_and_every_name_leads_somewhere():
    parts = {"name", "services", "networks", "volumes", "secrets", "configs"}
    assert {key for key in COMPOSE if not key.startswith("x-")} == parts
    for service in SERVICES.values():
        assert service.keys() <= SERVICE_FIELDS
        assert set(service.get("depends_on", {})) <= set(SERVICES)
        assert set(service["networks"]) <= set(COMPOSE["networks"])
        assert set(service.get("secrets", ())) <= set(COMPOSE["secrets"])
        assert {config["source"] for config in service.get("configs", ())} <= set(COMPOSE["configs"])
        named = [volume.split(":")[0] for volume in service.get("volumes", ())]
        assert {volume for volume in named if not volume.startswith(".")} <= set(COMPOSE["volumes"])
    for name in ("replay", "learner", "actors-1", "actors-2"):
        assert SERVICES[name]["depends_on"] == {"head": {"condition": "service_healthy"}}


def test_containers_have_no_more_rights_than_they_need_and_answer_on_this_machine_alone():
    for service in OURS.values():
        assert service["cap_drop"] == ["ALL"] and service["security_opt"] == ["no-new-privileges:true"]
        assert not service["user"].startswith("0")
    assert all(port.startswith("127.0.0.1:") for service in SERVICES.values() for port in service.get("ports", ()))


def test_each_container_has_the_certificates_of_its_roles_and_nodes_of_ray_the_token():
    kinds = {"head": "head", "replay": "replay", "learner": "learner", "monitor": "monitor"}
    script = (DEPLOY / "divide-certificates").read_text()
    for name, service in OURS.items():
        (folder,) = [volume.split(":") for volume in service["volumes"] if "tls" in volume]
        kind = kinds.get(name, "actors")
        assert folder == [f"../tls-{kind}", "/home/zsdist/tls", "ro"] and kind in script
        is_node = name != "monitor"
        assert ("ray-token" in service["secrets"]) == is_node
        assert (service["environment"].get("RAY_AUTH_MODE") == "token") == is_node


def test_the_head_waits_for_the_cores_of_all_nodes_and_then_starts_one_run_whatever_was_before():
    head = SERVICES["head"]["command"][-1]
    nodes = [head, *(service["command"] for name, service in OURS.items() if name not in ("head", "monitor"))]
    cores = sum(int(re.search(r"--num-cpus=(\d+)", command).group(1)) for command in nodes)
    assert f"await_cores.py head:6379 {cores}\n" in head
    assert "exec python -m zsdist.launch" in head and "--auto-resume" in head
    assert head.count("head:7447") == 1 and SERVICES["head"]["hostname"] == "head"


def test_the_shards_journals_are_on_a_disk_of_their_own():
    journals = re.search(r"replay.journals=\[(\S+)\]", SERVICES["head"]["command"][-1]).group(1)
    assert f"journals:{journals}" in SERVICES["replay"]["volumes"]


def test_prometheus_reads_the_monitor_and_grafana_the_dashboard():
    options = monitor.make_parser().parse_args(SERVICES["monitor"]["command"].split()[3:])
    scraped = yaml.safe_load(COMPOSE["configs"]["prometheus"]["content"])["scrape_configs"][0]
    assert scraped["static_configs"] == [{"targets": [f"monitor:{options.prometheus.port}"]}]
    assert (DEPLOY / COMPOSE["configs"]["dashboard"]["file"]).is_file()
    folder = yaml.safe_load(COMPOSE["configs"]["dashboards"]["content"])["providers"][0]["options"]["path"]
    assert any(config["target"].startswith(f"{folder}/") for config in SERVICES["grafana"]["configs"])
    assert all(re.search(r":v?\d+\.\d+\.\d+$", service["image"]) for service in SERVICES.values())


def test_ray_cluster_file_passes_rays_own_schema():
    validate_config(prepare_config(copy.deepcopy(RAY_CLUSTER)))


def test_rays_schema_refuses_an_unknown_key():
    with pytest.raises(Exception, match="sneaky"):
        validate_config({**prepare_config(copy.deepcopy(RAY_CLUSTER)), "sneaky": 1})


def test_ray_cluster_has_a_head_and_workers_up_to_its_limit_and_all_have_the_token():
    assert RAY_CLUSTER["provider"]["head_ip"] not in RAY_CLUSTER["provider"]["worker_ips"]
    assert len(RAY_CLUSTER["provider"]["worker_ips"]) == RAY_CLUSTER["max_workers"]
    assert RAY_CLUSTER["docker"]["image"] in IMAGES
    options = " ".join(RAY_CLUSTER["docker"]["run_options"])
    token = re.search(r"RAY_AUTH_TOKEN_PATH=(\S+)", options).group(1)
    assert "--env RAY_AUTH_MODE=token" in options and f":{token}:ro" in options


def service() -> configparser.ConfigParser:
    read = configparser.ConfigParser(strict=False, interpolation=None)
    read.optionxform = str
    read.read(DEPLOY / "zsdist-join.service")
    return read


def test_a_spare_pc_joins_one_run_after_the_other_and_its_user_comes_first():
    unit = service()["Service"]
    command = unit["ExecStart"].replace("${ZSDIST_HUB}", "tls/h:7447").replace("${ZSDIST_ACTORS}", "4").split()
    options = launch.make_parser().parse_args(command[command.index("zsdist.launch") + 1 :])
    assert (options.join, options.actors) == ("tls/h:7447", 4)
    assert unit["Restart"] == "always" and unit["CPUSchedulingPolicy"] == "idle"
    assert unit["KillMode"] == "mixed" and int(unit["TimeoutStopSec"]) > 8  # within which actors deliver


def test_systemd_knows_every_line_of_the_service(tmp_path):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not on the path")
    text = re.sub(r"^ExecStart=\S+", "ExecStart=/bin/true", (DEPLOY / "zsdist-join.service").read_text(), flags=re.M)
    (tmp_path / "zsdist-join.service").write_text(text)
    command = ["systemd-analyze", "verify", "--man=no", str(tmp_path / "zsdist-join.service")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    about = [line for line in done.stderr.splitlines() if "zsdist-join" in line]
    assert about == []


PAGES = ("deploy/README.md", "docs/cluster.md", "docs/kubernetes.md", "docs/slurm.md")


@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_are_ones_that_zsdist_understands(page):
    text = re.sub(r"\\\n\s*", " ", (ROOT / page).read_text())
    commands = re.findall(r"^ +python -m zsdist\.(\w+) (.*)$", text, re.MULTILINE)
    assert commands
    for name, words in commands:
        words = re.sub(r"\$\(.*?\)|\$HUB", "tls/h:7447", words)
        parser = importlib.import_module(f"zsdist.{name}").make_parser()
        parser.parse_args(shlex.split(words, comments=True))


@pytest.mark.parametrize("page", PAGES)
def test_pages_name_only_files_and_roles_that_exist(page):
    text = (ROOT / page).read_text()
    for name in re.findall(r"(?<![\w/.])(?:deploy|configs)/[\w./-]*\w", text):
        assert (ROOT / name).exists(), name
    for role in re.findall(r"zsdist_(\w+?)_", text):
        assert role in keys.ROLES
