"""Shell scripts of `deploy/`, run with stand-ins for the programs that they call."""

import contextlib
import os
import signal
import subprocess

import pytest
from deployments import DEPLOY, ROOT

from zsdist.roles import permissions
from zsdist.transport import certificates

STANDINS = {
    # Ray's processes stay until they are ended; the first word says what was started.
    "srun": 'echo "srun $*" >> "$CALLS"\nexec tail -f /dev/null\n',
    "scontrol": 'echo "scontrol $*" >> "$CALLS"\n',
    "getent": 'echo "10.1.2.3 STREAM host"\n',
    "python": """echo "python $* token=${RAY_AUTH_TOKEN:+set}" >> "$CALLS"
case "$*" in
    -c*) echo secret ;;
    *zsdist.certs*) touch "$3/ca.key" "$3/ca.pem" ;;
    *await_cores*) until [ "$(grep -c ^srun "$CALLS")" = 2 ]; do sleep 0.02; done ;;
    *zsdist.launch*)
        trap 'echo saved >> "$CALLS"; exit 138' USR1
        trap 'echo saved >> "$CALLS"; exit 143' TERM
        echo ready >&2
        [ -z "${WAITS:-}" ] || { tail -f /dev/null & wait $!; }
        exit "${STATUS:-0}" ;;
esac
""",
}


def slurm(tmp_path, *arguments, **environment) -> tuple[subprocess.Popen, "os.PathLike[str]"]:
    programs, calls = tmp_path / "bin", tmp_path / "calls"
    programs.mkdir()
    for name, body in STANDINS.items():
        (programs / name).write_text(f"#!/bin/bash\n{body}")
        (programs / name).chmod(0o755)
    about = {"SLURM_JOB_ID": "123456", "SLURM_NNODES": "3", "SLURM_CPUS_PER_TASK": "8", "CALLS": str(calls)}
    job = subprocess.Popen(
        ["bash", str(DEPLOY / "slurm.sbatch"), *arguments],
        env={**os.environ, **about, **environment, "PATH": f"{programs}:{os.environ['PATH']}"},
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    return job, calls


def ended(job: subprocess.Popen) -> int:
    try:
        return job.wait(timeout=30)
    finally:
        job.stderr.close()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(job.pid, signal.SIGKILL)


def test_a_job_starts_ray_on_its_nodes_and_one_run_on_all_cores_but_six(tmp_path):
    job, calls = slurm(tmp_path, "runs/first", "--episodes", "10")
    assert ended(job) == 0
    lines = calls.read_text().splitlines()
    head, others = sorted((line for line in lines if line.startswith("srun")), key=lambda line: "--head" not in line)
    assert "--nodes=1 " in head and "--port=23456" in head and "--nodelist=" in head
    assert "--nodes=2 " in others and "--address=10.1.2.3:23456" in others and "--exclude=" in others
    (launched,) = [line for line in lines if "zsdist.launch" in line]
    for part in ("--auto-resume --run-dir runs/first", "--address 10.1.2.3:23456", "--actors 18", "token=set"):
        assert part in launched
    assert "transport.endpoint=tls/10.1.2.3:33456 --episodes 10" in launched
    assert any("await_cores.py 10.1.2.3:23456 24" in line for line in lines)
    assert not list(tmp_path.glob(".zsdist-tls*")) and not any("requeue" in line for line in lines)


@pytest.mark.parametrize(("number", "status", "requeued"), [(signal.SIGUSR1, 138, True), (signal.SIGTERM, 143, False)])
def test_a_signal_reaches_the_launcher_alone_and_at_the_time_limit_the_job_is_queued_again(
    tmp_path, number, status, requeued
):
    job, calls = slurm(tmp_path, "runs/first", WAITS="1")
    assert any("ready" in line for line in job.stderr)
    job.send_signal(number)
    assert ended(job) == status
    assert "saved" in calls.read_text()
    assert ("scontrol requeue 123456" in calls.read_text()) == requeued
    assert not list(tmp_path.glob(".zsdist-tls*"))


def test_a_run_that_fails_fails_the_job_and_is_not_queued_again(tmp_path):
    job, calls = slurm(tmp_path, "runs/first", STATUS="2")
    assert ended(job) == 2 and "requeue" not in calls.read_text()


def test_a_job_without_a_run_directory_is_refused_with_its_usage(tmp_path):
    job, _ = slurm(tmp_path)
    errors = job.stderr.read()
    assert ended(job) != 0 and "usage: sbatch deploy/slurm.sbatch RUN_DIR" in errors


def divide(folder) -> subprocess.CompletedProcess:
    return subprocess.run([DEPLOY / "divide-certificates", folder], capture_output=True, text=True, timeout=60)


def test_each_kind_of_machine_gets_the_certificates_of_its_roles_and_none_the_authoritys_key(tmp_path):
    folder = tmp_path / "tls"
    certificates.make(folder, permissions.HUB, permissions.client_names(2), ["127.0.0.1"], days=1)
    for name in ("learner-high", "replay"):  # where they are made
        (folder / f"{name}.pem").touch()
    done = divide(folder)
    assert done.returncode == 0, done.stderr
    places = {path.name.removeprefix("tls-"): {file.name for file in path.iterdir()} for path in tmp_path.glob("tls-*")}
    assert places.keys() == {"head", "learner", "replay", "actors", "monitor"}
    everything = {file.name for file in folder.iterdir()}
    assert places["head"] == everything - {"ca.key"}
    assert places["actors"] == {name for name in everything if name.startswith("actor-")} | {"ca.pem"}
    assert places["monitor"] == {"ca.pem", "monitor.pem", "monitor.key"}
    assert {"ca.pem", "learner-high.pem"} <= places["learner"] and "replay.pem" not in places["learner"]
    modes = {path.stat().st_mode & 0o077 for path in tmp_path.glob("tls-*/**/*")}
    assert modes == {0}


@pytest.mark.parametrize("folder", ["", "no-such-folder"])
def test_a_folder_without_certificates_is_refused(tmp_path, folder):
    done = divide(tmp_path / folder)
    assert done.returncode == 2 and "usage:" in done.stderr


def test_the_scripts_are_those_that_the_pages_name():
    assert os.access(DEPLOY / "divide-certificates", os.X_OK)
    assert "deploy/divide-certificates tls" in (ROOT / "docs" / "kubernetes.md").read_text()
