"""Time from the command to the first training step by part, memory of all processes, and size of an installation.

`python benchmarks/startup.py [--checkout DIR ...]` prints tables, then one JSON line. In turn for each checkout
(default: this one), `--repeat` times, `zsdist.launch` starts a default run in a temporary folder, with the caches of
this user as they are, and is stopped `--settle` seconds after its first training step. Figures are medians. Their names
begin with the number of the checkout; ratios compare the second with the first.

The parts end when: the launcher says that it prepares the run (`import`), the run directory is there (`compile`:
checks, and code that is compiled or read from its cache), the hub listens (`ray`: Ray itself and its first process),
all roles have reported (`roles`), an actor has driven a step (`episode`). Seconds of processor time are those of all
processes together; they depend less on what else the machine does. `ray_alone` is the start of Ray by
`zsdist.run.ray`, without a run. Memory is the proportional set size: pages that processes share count once in the sum.
"""

import argparse
import contextlib
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from importlib.metadata import distributions
from pathlib import Path

from _common import report, require

PARTS = ("import", "compile", "ray", "roles", "episode")
SETTINGS = ("run.final_evaluation_episodes=0", "merge.every_episodes=100000", "run.episodes=100000")
ROLES = ("scheduler", "replay", "learner", "actor")
LOOK_EVERY_S = 0.05
RAY_ALONE = """
import time
from zsdist.run import local_ray
local_ray.stay_on_loopback()
from zsdist.config import Config
from zsdist.run import ray
import os, resource
began_s = time.monotonic()
ray.connect(Config())
print(time.monotonic() - began_s, flush=True)
input()
"""
MB = 2**20
PROC = Path("/proc")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--checkout", action="append", type=Path, metavar="DIR", help="checkout to run; repeatable")
    parser.add_argument("--repeat", type=int, default=3, metavar="N", help="runs of each checkout (default: 3)")
    parser.add_argument("--settle", type=float, default=20.0, metavar="S", help="seconds before memory is read")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change one setting")
    parser.add_argument("--installation", action="store_true", help="only the size of the installation")
    options = parser.parse_args()
    print(f"load of this machine: {os.getloadavg()}, {os.cpu_count()} cores")
    figures = installation()
    if options.installation:
        report("startup", figures, {})
        return
    checkouts = [path.resolve() for path in options.checkout or [Path(__file__).parent.parent]]
    measured: dict[int, list[dict[str, float]]] = defaultdict(list)
    for repetition in range(options.repeat):
        for index, checkout in enumerate(checkouts):
            print(f"\n{checkout}, run {repetition + 1} of {options.repeat}")
            measured[index].append(ray_alone(checkout) | one_run(checkout, options.set, options.settle))
    medians = {
        index: {name: statistics.median(run.get(name, 0.0) for run in runs) for name in runs[0]}
        for index, runs in measured.items()
    }
    for index, values in medians.items():
        figures |= {f"{index}_{name}": value for name, value in values.items()}
    compared = ("to_first_step_s", "to_first_step_cpu_s", "ray_alone_s", "ray_alone_cpu_s", "pss_mb")
    ratios = {name: medians[1][name] / medians[0][name] for name in compared} if len(medians) > 1 else {}
    report("startup", figures, ratios)


def one_run(checkout: Path, settings: list[str], settle_s: float) -> dict[str, float]:
    """Return the figures of a run, which is stopped once its memory is known."""
    require("zenoh", "make install")
    chosen = [part for setting in (*SETTINGS, *settings) for part in ("--set", setting)]
    with tempfile.TemporaryDirectory(prefix="start-") as name:
        folder = Path(name) / "run"
        command = [sys.executable, "-m", "zsdist.launch", "--plain", "--seed", "1", "--run-dir", str(folder), *chosen]
        environment = os.environ | {"PYTHONPATH": str(checkout), "PYTHONUNBUFFERED": "1"}
        began_s = time.monotonic()
        with (Path(name) / "log").open("w+") as log:
            run = subprocess.Popen(command, cwd=name, env=environment, stdout=log, stderr=subprocess.STDOUT)
            latest: dict[str, dict] = {}
            try:
                with contextlib.ExitStack() as sessions:
                    ends, cpu_s = watch(run, folder, Path(name) / "log", began_s, latest, sessions)
                    time.sleep(settle_s)
                names = {int(fields["pid"]): name for name, fields in dict(latest).items() if "pid" in fields}
                memory, used_s = by_process(run.pid, names)
            finally:
                run.send_signal(signal.SIGINT)
                time.sleep(1.0)  # signals that follow at once count as one
                run.send_signal(signal.SIGINT)
                run.wait()
    begins = (0.0, *(ends[part] for part in PARTS))
    print(f"{'part':12}{'s':>8}{'CPU s':>8}")
    figures = {}
    for begin, part, before in zip(begins, PARTS, (None, *PARTS), strict=False):
        figures[f"{part}_s"] = ends[part] - begin
        figures[f"{part}_cpu_s"] = cpu_s[part] - (cpu_s[before] if before else 0.0)
        print(f"{part:12}{figures[f'{part}_s']:8.2f}{figures[f'{part}_cpu_s']:8.2f}")
    figures |= {"to_first_step_s": ends["episode"], "to_first_step_cpu_s": cpu_s["episode"]}
    print(f"{'together':12}{ends['episode']:8.2f}{cpu_s['episode']:8.2f}\n\n{'process':24}{'PSS MB':>8}{'CPU s':>8}")
    for process, size in sorted(memory.items(), key=lambda item: -item[1]):
        print(f"{process:24}{size:8.0f}{used_s[process]:8.1f}")
    print(f"{'together':24}{sum(memory.values()):8.0f}{sum(used_s.values()):8.1f}")
    figures |= {f"pss_mb_{process.replace(' ', '_')}": size for process, size in memory.items()}
    return figures | {"pss_mb": sum(memory.values())}


def watch(
    run: subprocess.Popen,
    folder: Path,
    log: Path,
    began_s: float,
    latest: dict[str, dict],
    sessions: contextlib.ExitStack,
) -> tuple[dict[str, float], dict[str, float]]:
    """Return when each part ended, and the processor time until then; `latest` gets the last statistics of each role.

    The session that fills it ends with `sessions`.
    """
    import zenoh

    ends: dict[str, float] = {}
    cpu_s: dict[str, float] = {}
    session = None
    while "episode" not in ends:
        if run.poll() is not None:
            raise SystemExit(f"zsdist.launch ended with status {run.returncode}: {log.read_text()[-2000:]}")
        if session is None and (folder / "endpoint").exists() and (endpoint := (folder / "endpoint").read_text()):
            session = sessions.enter_context(_session(zenoh, endpoint, latest))
        seen = dict(latest)  # another thread adds to it
        reported = {name.partition("-")[0] for name in seen}
        steps = sum(fields.get("env_steps", 0) for name, fields in seen.items() if name.startswith("actor"))
        reached = {
            "import": "preparing" in log.read_text(),
            "compile": (folder / "config.yaml").exists(),
            "ray": session is not None,
            "roles": reported >= set(ROLES),
            "episode": steps > 0 and reported >= set(ROLES),
        }
        for part, is_reached in reached.items():
            if is_reached and part not in ends:
                ends[part] = time.monotonic() - began_s
                cpu_s[part] = sum(_cpu_s(pid) for pid in _family(run.pid))
        time.sleep(LOOK_EVERY_S)
    return ends, cpu_s


def _session(zenoh, endpoint: str, latest: dict[str, dict]):  # noqa: ANN001, ANN202 (a module that may be missing)
    """Open a session that notes the last statistics of each role."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    session = zenoh.open(config)

    def note(sample) -> None:  # noqa: ANN001
        fields = json.loads(sample.payload.to_bytes())
        latest[f"{fields['role']}-{fields['id']}"] = fields

    session.declare_subscriber("zsdist/*/stats/*/*", note)
    return session


def ray_alone(checkout: Path) -> dict[str, float]:
    """Return wall and processor time of the start of Ray, without a run."""
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    process = subprocess.Popen(
        [sys.executable, "-c", RAY_ALONE], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    line = process.stdout.readline()
    time.sleep(5.0)  # what it starts without waiting for it
    others = sum(_cpu_s(pid) for pid in _family(process.pid) - {process.pid})
    processes = len(_family(process.pid))
    process.communicate("\n")
    if not line:
        raise SystemExit("Ray could not be started")
    print(f"Ray alone: {float(line):.2f} s, {others:.2f} s of processor in {processes} processes after 5 s")
    return {"ray_alone_s": float(line), "ray_alone_cpu_s": others, "ray_alone_processes": processes}


def by_process(launcher: int, names: dict[int, str]) -> tuple[dict[str, float], dict[str, float]]:
    """Return the proportional set size in MB and the processor time of each process of a launcher's family."""
    sizes: dict[str, float] = defaultdict(float)
    used_s: dict[str, float] = defaultdict(float)
    for pid in sorted(_family(launcher)):
        try:
            lines = (PROC / str(pid) / "smaps_rollup").read_text().splitlines()
            command = (PROC / str(pid) / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue  # it has ended
        size = next((int(line.split()[1]) for line in lines if line.startswith("Pss:")), 0) * 1024 / MB
        title = "launcher" if pid == launcher else names.get(pid) or _title(command)
        sizes[title] += size
        used_s[title] += _cpu_s(pid)
    return dict(sizes), dict(used_s)


def _title(command: list[bytes]) -> str:
    """Return a short name of a process from its command line."""
    words = [word.decode(errors="replace") for word in command if word]
    if words and words[0].startswith("ray::"):
        return {"ray::RoleHost": "standby"}.get(words[0], words[0].removeprefix("ray::"))
    scripts = [Path(word).stem for word in words[:6] if word.endswith(".py")]
    modules = [words[index + 1] for index, word in enumerate(words[:-1]) if word == "-m"]
    return (scripts or modules or [Path(words[0]).name if words else "gone"])[0]


def _family(pid: int) -> set[int]:
    """Return a process and all its descendants."""
    children = defaultdict(list)
    for folder in PROC.iterdir():
        if folder.name.isdigit() and (fields := _stat(int(folder.name))):
            children[int(fields[1])].append(int(folder.name))
    family, waiting = set(), [pid]
    while waiting:
        family.add(current := waiting.pop())
        waiting += children[current]
    return family


def _cpu_s(pid: int) -> float:
    """Return the processor time of a process and of its children that have ended."""
    fields = _stat(pid)
    return sum(int(field) for field in fields[11:15]) / os.sysconf("SC_CLK_TCK") if fields else 0.0


def _stat(pid: int) -> list[str]:
    try:
        return (PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def installation() -> dict[str, float]:
    """Return the size in MB of the environment's largest packages, and of all."""
    sizes = {}
    for distribution in distributions():
        files = {Path(distribution.locate_file(file)).resolve() for file in distribution.files or ()}
        sizes[distribution.metadata["Name"]] = sum(path.stat().st_size for path in files if path.is_file()) / MB
    print(f"\n{'package':28}{'MB':>8}")
    for name, size in sorted(sizes.items(), key=lambda item: -item[1])[:20]:
        print(f"{name:28}{size:8.0f}")
    print(f"{'all ' + str(len(sizes)):28}{sum(sizes.values()):8.0f}\n")
    largest = dict(sorted(sizes.items(), key=lambda item: -item[1])[:12])
    return {f"mb_{name.replace('-', '_')}": size for name, size in largest.items()} | {"mb_all": sum(sizes.values())}


if __name__ == "__main__":
    main()
