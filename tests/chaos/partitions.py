"""Measurement of what cut, frozen, slow and narrow connections do to a run of real processes.

`python tests/chaos/partitions.py [--results FILE] [--cases WORD ...]`

Each kind of role connects to the hub through a proxy of its own. Each case disturbs one of them for some seconds; then
frames must flow again. At the end of the run, the counts of `tests/chaos/oracle.py` must show no fault. Two more runs
have weights of 8 MiB and actors behind 10 MB a second: they must have new weights in time, also an actor that joins
late. The figures are the last line of the output.
"""

import argparse
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import oracle
from kills import Killing
from proxy import Proxy
from small_run import PROXIES, end_cleanly

PORT = 7801
KINDS = ("actor", "replay", "learner", "scheduler", "supervisor")
SHORT_S, LONG_S = 2.0, 12.0  # shorter and longer than the 5 s after which zenoh closes a silent connection
CASES = [
    *((kind, "cut", seconds) for kind in KINDS for seconds in (SHORT_S, LONG_S)),
    *((kind, "frozen", seconds) for kind in KINDS for seconds in (SHORT_S, LONG_S)),
    *((kind, "delay", LONG_S) for kind in KINDS),
    ("all", "cut", SHORT_S),
    ("all", "cut", LONG_S),
    ("all", "frozen", LONG_S),
    ("all", "delay", LONG_S),
]
DELAY_S = 0.25
NARROW = 10_000_000  # bytes a second
WIDE_NETWORKS = ("low.hidden=[1280,1280]", "replay.batch_initial=16", "low.updates_per_insert=0.02")
FRESH_WITHIN_S = 60.0


def disturb(proxies: dict[str, Proxy], kind: str, fault: str) -> None:
    """Begin a fault of one kind of role, or of all."""
    for name, proxy in proxies.items():
        if kind not in (name, "all"):
            continue
        match fault:
            case "cut":
                proxy.cut()
            case "frozen":
                proxy.frozen = True
            case "delay":
                proxy.delay_s = DELAY_S


def begin(root: Path, *settings: str) -> tuple[Killing, dict[str, Proxy]]:
    """Start a run whose roles connect through proxies."""
    ports = {kind: PORT + index for index, kind in enumerate(KINDS)}
    os.environ[PROXIES] = json.dumps(ports)
    killing = Killing(root, 0, *settings)
    endpoint = killing.launcher.folder / "endpoint"
    proxies = {kind: Proxy(port, lambda: int(endpoint.read_text().rpartition(":")[2])) for kind, port in ports.items()}
    return killing, proxies


def partitions(words: list[str]) -> dict:
    """Run once through all cases that contain one of the words, and return what happened."""
    found = {}
    with tempfile.TemporaryDirectory(prefix="partitions-") as root:
        killing, proxies = begin(Path(root))
        try:
            for kind, fault, seconds in CASES:
                name = f"{kind} {fault} {seconds:g}"
                if words and not any(word in name for word in words):
                    continue
                killing.await_calm(standby=False)
                disturb(proxies, kind, fault)
                until_s = time.time() + seconds
                killing.wait_for(lambda until_s=until_s: time.time() > until_s, "the end of a fault")
                for proxy in proxies.values():
                    proxy.mend()
                healed_s = time.time()
                killing.wait_for(lambda since_s=healed_s: killing.tail.last_s > since_s, f"a frame after {name}")
                found[name] = round(killing.tail.last_s - healed_s, 3)
                print(f"{name}: a frame {found[name]:.3f} s after its end", file=sys.stderr, flush=True)
            return {"cases": found} | killing.finish()
        finally:
            killing.abandon()
            for proxy in proxies.values():
                proxy.close()


def narrow_link() -> dict:
    """Run with large weights and actors behind a narrow link; return the seconds until an actor has new weights."""
    with tempfile.TemporaryDirectory(prefix="narrow-") as root:
        killing, proxies = begin(Path(root), *WIDE_NETWORKS)
        proxies["actor"].bytes_per_s = NARROW
        try:
            killing.await_calm(standby=True)
            times = {"first": _fresh(killing), "next": _fresh(killing)}
            _, epoch, _ = killing.strike("actor", signal.SIGKILL)
            killing.wait_for(lambda: killing.witness.statistics["actor-0"]["epoch"] > epoch, "another actor")
            times["late joiner"] = _fresh(killing)
            return {"narrow": times} | killing.finish()
        finally:
            killing.abandon()
            for proxy in proxies.values():
                proxy.close()


def _fresh(killing: Killing) -> float:
    """Return the seconds until the actor acts with a version of the weights that the learner has only now."""
    wanted = killing.witness.statistics["learner-low"]["weight_version"]
    start_s = time.time()

    def has_it() -> bool:
        return killing.witness.statistics["actor-0"].get("low_weight_version", -1) > wanted

    killing.wait_for(has_it, "new weights at the actor", FRESH_WITHIN_S)
    return round(time.time() - start_s, 2)


def main() -> None:
    """Run all, add the results to a file, and print them."""
    end_cleanly()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=Path("runs/partitions.jsonl"), help="appended to")
    parser.add_argument("--cases", nargs="*", default=[], help="only cases with one of these words; narrow is one too")
    options = parser.parse_args()
    options.results.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    if options.cases != ["narrow"]:
        rows.append(partitions(options.cases))
    if not options.cases or "narrow" in options.cases:
        rows.append(narrow_link())
    with options.results.open("a") as file:
        file.writelines(json.dumps(row) + "\n" for row in rows)
    print(json.dumps({name: value for row in rows for name, value in row.items() if name in ("cases", "narrow")}))
    sys.exit(any(row[name] for row in rows for name in oracle.FAULTS))


if __name__ == "__main__":
    main()
