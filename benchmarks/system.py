"""Rates, weight lag, samples per insert, and CPU time by part, of a whole run and of an actor.

`python benchmarks/system.py [--quick]` prints tables, then one JSON line. First, `zsdist.launch` trains with two actor
processes in a temporary folder, without merges and evaluation, monitored over zenoh: figures come from the statistics
that roles publish, and the CPU time of each role's process from the kernel, between the first and the last training
step seen. Then the same run is repeated, with the first run's cache of vision readings (`again_1_...`). Then a run in
one process without that cache is sampled by CPU time: `share_run_...` are shares of the whole run's CPU time by
package, `share_actor_...` of the actor's. A sample counts for the innermost package of zsdist on the stack, so that the
time of numpy or torch counts for its caller.
"""

import argparse
import collections
import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import FrameType

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one core, as for a role; set before numpy and torch read it

from _common import report

import zsdist
from zsdist import launch
from zsdist.config import load
from zsdist.run import directory
from zsdist.transport.base import Mailbox
from zsdist.transport.zenoh import ZenohTransport
from zsdist.wire import keys

PACKAGE = Path(zsdist.__file__).parent
MAILBOX_BYTES = 1 << 24
SAMPLE_EVERY_S = 0.01  # of CPU time; longer than any call during which Python handles no signals
ACTORS = 2
LEVELS = ("high", "low")
AGAIN = ("env_steps_per_s", "remembered_share", "cpu_cores_used", "env_steps_per_actor_cpu_s")
QUIET = ("run.final_evaluation_episodes=0", "merge.every_episodes=100000")

Statistics = dict[str, dict]  # last statistics of each role by its name, with the CPU seconds of its process


def main() -> None:
    """Run all measurements and print their figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer episodes; ends within 80 s on two cores")
    parser.add_argument("--weights", default="pretrained", help="vision.weights of the runs (default: pretrained)")
    parser.add_argument(
        "--episodes",
        type=int,
        metavar="N",
        help="episodes of the first run; the last has a quarter",
    )
    parser.add_argument(
        "--again", type=int, default=1, metavar="N", help="repetitions with a filled cache (default: 1)"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="change one setting; repeatable"
    )
    options = parser.parse_args()
    episodes = options.episodes or (20 if options.quick else 300)
    given = {text.partition("=")[0] for text in options.set}
    settings = [*QUIET, f"vision.weights={options.weights}"]
    settings = [*(text for text in settings if text.partition("=")[0] not in given), *options.set]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _use_empty_cache(folder / "machine")
        figures, ratios = _distributed(folder / "system", episodes, settings)
        for repetition in range(1, options.again + 1):
            again, _ = _distributed(folder / f"again-{repetition}", episodes, settings)
            figures |= {f"again_{repetition}_{name}": again[name] for name in AGAIN if name in again}
        _use_empty_cache(folder / "another machine")
        figures |= _profile(folder / "inline", max(1, episodes // 4), settings)
    report("system", figures, ratios)


def _use_empty_cache(folder: Path) -> None:
    """Give the following runs an empty folder for temporary files, and so an empty cache of vision readings."""
    folder.mkdir()
    os.environ["TMPDIR"] = tempfile.tempdir = str(folder)


def _arguments(folder: Path, episodes: int, settings: list[str]) -> list[str]:
    chosen = [argument for setting in settings for argument in ("--set", setting)]
    return ["--episodes", str(episodes), "--seed", "1", "--plain", "--run-dir", str(folder), *chosen]


def _distributed(folder: Path, episodes: int, settings: list[str]) -> tuple[dict[str, float], dict[str, float]]:
    """Return figures and ratios of a run with two actor processes."""
    command = [sys.executable, "-m", "zsdist.launch", "--actors", str(ACTORS), *_arguments(folder, episodes, settings)]
    began_s = time.time()
    with open(folder.parent / "launch.log", "w+") as log:
        run = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        try:
            seen = _watch(run, folder)
        finally:
            if run.poll() is None:
                run.send_signal(signal.SIGINT)
                run.wait()
        if run.returncode:
            log.seek(0)
            raise SystemExit(f"zsdist.launch ended with status {run.returncode}: {log.read()[-2000:]}")
    rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    summary = json.loads((folder / "summary.json").read_text())
    first, last = seen[0], seen[-1]
    wall_s = _increase(first, last, "scheduler-0", "time_s")
    actors = [name for name in first if name.startswith("actor-")]

    def rate(name: str, field: str) -> float:
        return _increase(first, last, name, field) / _increase(first, last, name, "time_s")

    figures = {
        "start_up_s": first["scheduler-0"]["time_s"] - began_s,
        "measured_s": wall_s,
        "env_steps_per_s": sum(rate(name, "env_steps") for name in actors),
        "cpu_cores_used": sum(rate(name, "cpu_s") for name in first),
        "max_lag_versions": summary["weights"]["max_lag_versions"],
    }
    print(f"{'per second of the run, by role':30}{'CPU s':>9}{'waiting s':>11}")
    for name in sorted(first):
        waited = [field for field in last[name] if field.startswith("waiting_") and field in first[name]]
        waiting = {field: rate(name, field) for field in waited}
        print(f"{name:30}{rate(name, 'cpu_s'):9.3f}" + "".join(f"{ms:11.3f} {field}" for field, ms in waiting.items()))
        key = name.replace("-", "_")
        figures[f"share_cpu_{key}"] = rate(name, "cpu_s") / figures["cpu_cores_used"]
        figures |= {f"{key}_{field}_per_s": value for field, value in waiting.items()}
    ratios, config = {}, load(folder / "config.yaml")
    for level in LEVELS:
        updates = rate(f"learner-{level}", "learner_updates")
        inserts, samples = (rate("replay-0", f"{level}_{name}") for name in ("stored", "sampled"))
        lags = [row[f"{level}_lag_versions"] for row in rows if f"{level}_lag_versions" in row]
        figures |= {
            f"{level}_updates_per_s": updates,
            f"{level}_samples_per_s": samples,
            f"{level}_samples_per_insert": samples / inserts,
            f"{level}_mean_lag_versions": sum(lags) / max(1, len(lags)),
        }
        served = last["replay-0"][f"{level}_updates_served"] / last["replay-0"][f"{level}_stored"]
        ratios[f"{level}_updates_per_insert_vs_setting"] = served / getattr(config, level).updates_per_insert
    kinds = ("cache_hits", "cache_misses", "cache_bypasses")
    readings = {
        kind: sum(_increase(first, last, name, kind) for name in actors if kind in first[name]) for kind in kinds
    }
    if total := sum(readings.values()):
        figures["remembered_share"] = readings["cache_hits"] / total
        figures["off_the_lattice_share"] = readings["cache_bypasses"] / total
    figures["env_steps_per_actor_cpu_s"] = sum(_increase(first, last, name, "env_steps") for name in actors) / sum(
        _increase(first, last, name, "cpu_s") for name in actors
    )
    return figures, ratios


def _watch(run: subprocess.Popen, folder: Path) -> list[Statistics]:
    """Return the last statistics of all roles at each new report, from the first training step to the last."""
    transport, mailbox, latest, seen = None, Mailbox(MAILBOX_BYTES), {}, []
    steps = -1
    try:
        while run.poll() is None:
            time.sleep(0.1)
            if transport is None and (folder / "endpoint").exists():
                transport = ZenohTransport((folder / "endpoint").read_text())
                transport.subscribe(keys.stats(directory.key_name(folder), keys.ANY, keys.ANY), mailbox)
            for message in mailbox.drain():
                fields = json.loads(message.payload)
                latest[f"{fields['role']}-{fields['id']}"] = fields | {"cpu_s": _cpu_s(fields["pid"])}
            now = sum(fields.get("env_steps", 0) for name, fields in latest.items() if name.startswith("actor-"))
            everyone = {f"actor-{index}" for index in range(ACTORS)} | {f"learner-{level}" for level in LEVELS}
            complete = latest.keys() >= everyone | {"scheduler-0", "replay-0"}
            if now > max(0, steps) and complete and all(fields["cpu_s"] is not None for fields in latest.values()):
                seen.append(dict(latest))
                steps = now
    finally:
        if transport is not None:
            transport.close()
    if len(seen) < 2 and run.returncode == 0:
        raise SystemExit("the run ended before every role had reported twice; use more --episodes")
    return seen


def _cpu_s(pid: int) -> float | None:
    """Return the CPU seconds of a process so far, user and system; None if it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _increase(first: Statistics, last: Statistics, name: str, field: str) -> float:
    return last[name][field] - first[name][field]


def _profile(folder: Path, episodes: int, settings: list[str]) -> dict[str, float]:
    """Return shares of CPU time by package, of a run in one process and of the actor in it."""
    counts = {"run": collections.Counter(), "actor": collections.Counter()}

    def sample(number: int, frame: FrameType | None) -> None:
        stack = []
        while frame is not None:
            path = Path(frame.f_code.co_filename)
            if path.is_relative_to(PACKAGE):
                stack.append((path.relative_to(PACKAGE).with_suffix("").parts, frame.f_code.co_name))
            frame = frame.f_back
        if not any(name == "_step_all" for _, name in stack):
            return  # before the run, or after it
        counts["run"][_part(stack[0][0])] += 1
        if any(parts == ("roles", "actor") for parts, _ in stack):
            counts["actor"][_part(stack[0][0])] += 1

    options = launch.make_parser().parse_args(
        ["--single-process", "--actors", "1", *_arguments(folder, episodes, settings)]
    )
    before = signal.signal(signal.SIGPROF, sample)
    signal.setitimer(signal.ITIMER_PROF, SAMPLE_EVERY_S, SAMPLE_EVERY_S)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            launch.main(options)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    figures = {}
    for subject, counted in counts.items():
        total = counted.total()
        print(f"\nCPU time of the {subject} by package ({total} samples)")
        for part, count in counted.most_common():
            print(f"  {part:28}{count / total:8.1%}")
            figures[f"share_{subject}_{part.replace('.', '_')}"] = count / total
        figures[f"{subject}_samples"] = total
    return figures


def _part(parts: tuple[str, ...]) -> str:
    """Return the name of a part, such as `vision` or `sim.camera`; in `sim` and `planning` each module is a part."""
    return ".".join(parts[:2]) if parts[0] in ("sim", "planning") else parts[0]


if __name__ == "__main__":
    main()
