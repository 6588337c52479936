"""Slow, hung and full disks, and clocks that jump, under a run of real processes.

`python tests/chaos/disks_and_clocks.py [--cases slow hung clock full]`

| case | what happens | what must be |
|---|---|---|
| slow | each write takes 20 ms, then 200 ms | frames arrive, and all of them once the disk is fast again |
| hung | each write takes 20 s | the roles that hang are replaced, and the run goes on once the disk works |
| clock | it jumps an hour ahead and back, two hours in all, and each role is killed at each time | the run goes on |
| full | the run directory is on a disk of 48 MiB that fills up | one line, exit status 2, a checkpoint to resume |

Cases with a full disk need a file system of their own, in a user namespace (`unshare --map-root-user --mount`). At the
end of each case, the counts of `tests/chaos/oracle.py` must show no fault. The figures are the last line of the output.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import oracle
from kills import ROLES, Killing
from small_run import Launcher, end_cleanly
from tamper import Tamper

from zsdist.run import checkpoint_files

CASES = ("slow", "hung", "clock", "full")
SLOW_S = (0.02, 0.2)
HUNG_S = 20.0
LASTS_S = 10.0
HOUR_S = 3600.0
OWN_DISK = "ZSDIST_CHAOS_OWN_DISK"  # variable: the file system of the run's folder, in the namespace of this process
DISK_BYTES = 48 * 2**20
LEFT_BYTES = 256 * 1024


def disturbed(case: str) -> dict:
    """Run once with a slow or hung disk, or with a jumping clock."""
    with tempfile.TemporaryDirectory(prefix=f"{case}-") as root:
        tamper = Tamper(Path(root) / "tamper")
        killing = Killing(Path(root), 0)
        found = {}
        try:
            killing.await_calm(standby=True)
            match case:
                case "slow":
                    for write_s in SLOW_S:
                        found[f"{write_s:g}"] = _with_disk(killing, tamper, write_s)
                case "hung":
                    found["hung"] = _with_disk(killing, tamper, HUNG_S)
                case _:
                    for offset_s in (HOUR_S, -HOUR_S, 0.0):
                        tamper.set(clock_s=offset_s)
                        for role in ROLES:
                            killing.kill_once(role, signal.SIGKILL)
                        found[f"{offset_s:g}"] = killing.row["resumed_s"][-len(ROLES) :]
            return {case: found} | killing.finish()
        finally:
            killing.abandon()


def _with_disk(killing: Killing, tamper: Tamper, write_s: float) -> dict:
    """Make the disk slow for a while; return the frames that arrived, and the time until the first one afterwards."""
    before = killing.tail.read()
    tamper.set(write_s=write_s)
    until_s = time.time() + LASTS_S
    killing.wait_for(lambda: time.time() > until_s, "the end of a slow disk")
    tamper.set()
    arrived, mended_s = killing.tail.read() - before, time.time()
    killing.wait_for(lambda: killing.tail.last_s > mended_s, "a frame afterwards")
    again_s = round(killing.tail.last_s - mended_s, 3)
    killing.await_calm(standby=True)
    return {"frames": arrived, "again_s": again_s}


def full_disk() -> dict:
    """Fill the file system of the run directory, resume once there is room, and compare everything."""
    if OWN_DISK not in os.environ:
        return _in_own_namespace()
    root = Path(os.environ[OWN_DISK])
    subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(root)], check=True, capture_output=True
    )
    killing = Killing(root, 0, "run.checkpoint_every_s=3", "replay.size_initial=30000", "replay.size_max=30000")
    try:
        killing.await_calm(standby=True)
        folder = killing.launcher.folder
        killing.wait_for(lambda: len(checkpoint_files.checkpoints(folder)) > 0, "a checkpoint")
        filler = root / "filler"
        room = os.statvfs(root)
        with filler.open("wb") as file:
            file.write(bytes(room.f_bavail * room.f_frsize - LEFT_BYTES))
        full_s = time.time()
        status = killing.launcher.wait(60.0)
        found = {"status": status, "ended_s": round(time.time() - full_s, 2), "message": killing.launcher.last_words()}
        found["whole"] = [
            path.name for path in checkpoint_files.checkpoints(folder) if checkpoint_files.read_checkpoint(path)
        ]
        filler.unlink()
        killing.tail.read()
        killing.launcher = Launcher(root)
        killing.witness.attach(killing.launcher)
        return {"full": found} | killing.finish()
    finally:
        killing.abandon()


def _in_own_namespace() -> dict:
    with tempfile.TemporaryDirectory(prefix="full-") as root:
        command = ["unshare", "--map-root-user", "--mount", sys.executable, __file__, "--cases", "full"]
        result = subprocess.run(command, env=os.environ | {OWN_DISK: root}, stdout=subprocess.PIPE, text=True)
        lines = result.stdout.splitlines()
        if not lines:
            sys.exit("full: a user namespace with a file system of its own is not allowed here")
        return json.loads(lines[-1])


def main() -> None:
    """Run the cases, and print what happened."""
    end_cleanly()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", choices=CASES, default=CASES)
    rows = [full_disk() if case == "full" else disturbed(case) for case in parser.parse_args().cases]
    print(json.dumps({name: value for row in rows for name, value in row.items() if name in (*CASES, *oracle.COUNTS)}))
    sys.exit(any(row[name] for row in rows for name in oracle.FAULTS))


if __name__ == "__main__":
    main()
