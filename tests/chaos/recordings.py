"""Recordings under kills: a recording is killed in the middle, again and again, and all that it finished is read.

`python tests/chaos/recordings.py [--kills 50] [--results FILE]`, or `make chaos`

Everything is real: car, camera, MCAP files and the Minari set that grows beside them. Each process resumes the set of
the one before. After each kill every finished episode is read by three readers that are not ours (mcap, rosbags,
Minari) and by ours. A kill adds a line of JSON to FILE, and a second call goes on behind the last line.
"""

import argparse
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

EPISODES = 250  # more than are driven before fifty kills; the scenes of all are drawn at each start
MOST_FINISHED = 2  # episodes that a process finishes before it is killed
LAST = 6  # episodes that are read after a kill; older ones were read after earlier ones, and do not change
LONGEST_S = 3.0  # from then on to the kill in an episode
LONGEST_EXPORT_S = 0.1  # and in its export to Minari
WITHIN_S = 900.0
WORLD = ("sim.max_steps=15", "camera.size_px=64")


def forked(work: Callable[[], None]) -> int:
    """Run a function in a child process, which ends with status 0 where it returns; return its number."""
    child = os.fork()
    if child:
        return child
    status = 1
    try:
        work()
        status = 0
    except BaseException as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
    os._exit(status)


def call(*words: str) -> None:
    """Record with the options given, in this process."""
    from zsdist import record

    given = ["random", "--scenes", "singleton", "--workers", "1", *(f"--set={setting}" for setting in WORLD), *words]
    record.main(record.make_parser().parse_args(given))


def warm_up() -> None:
    """Import and compile in this process what all its children use."""
    from zsdist.recording import minari_export

    minari_export.require_minari()
    with tempfile.TemporaryDirectory() as folder:
        call("--episodes", "1", "--out", folder)


def record_more(folder: Path) -> None:
    """Resume the set in a folder until the process is killed."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    resume = ["--resume"] if (folder / "set.json").exists() else []
    call("--episodes", str(EPISODES), "--format", "minari", "--out", str(folder), *resume)


def read_all(folder: Path, result: Path) -> None:
    """Read every finished episode with every reader, and write how many there are."""
    import minari
    from mcap.reader import make_reader
    from rosbags.rosbag2 import Reader

    from zsdist.recording.episode import read_episode
    from zsdist.recording.recorded_set import RecordedSet

    files = RecordedSet(folder).episodes() if (folder / "set.json").exists() else {}
    assert list(files) == list(range(len(files))), f"episodes {list(files)} have a gap"
    for path in list(files.values())[-LAST:]:
        steps = len(read_episode(path).actions)
        with path.open("rb") as file:
            count = sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())
        with Reader(path) as bag:
            assert bag.message_count == count == sum(1 for _ in bag.messages()) > 4 * steps
    exported = [path.parent for path in folder.glob("minari/zsdist/*/data/metadata.json")]
    episodes = 0
    for data in exported:
        found = minari.MinariDataset(data)
        episodes = found.total_episodes
        for number in range(max(0, episodes - LAST), episodes):
            (one,) = found.iterate_episodes([number])
            read = read_episode(files[number])
            assert (one.observations["image"] == read.pictures).all() and (one.actions == read.actions).all()
    assert len(files) - 1 <= episodes <= len(files), f"{len(files)} episodes are recorded and {episodes} exported"
    result.write_text(json.dumps({"episodes": len(files), "minari": episodes}))


def kill_one(folder: Path, moment: random.Random, *, in_export: bool) -> dict:
    """Start a recording, kill it in the middle of an episode or of its export, and return what it left."""
    unfinished = "minari/zsdist/*/.data.partial" if in_export else ".episode-*.partial"
    wanted = len(list(folder.glob("episode-*.mcap"))) + moment.randrange(MOST_FINISHED + 1)
    started = forked(lambda: record_more(folder))
    began_s = time.monotonic()
    while len(list(folder.glob("episode-*.mcap"))) < wanted or not list(folder.glob(unfinished)):
        assert time.monotonic() - began_s < WITHIN_S, "the recording does not go on"
        if os.waitpid(started, os.WNOHANG)[0]:
            raise AssertionError("the recording has ended by itself")
        time.sleep(0.002)
    after_s = moment.uniform(0.0, LONGEST_EXPORT_S if in_export else LONGEST_S)
    time.sleep(after_s)
    os.kill(started, signal.SIGKILL)
    os.waitpid(started, 0)
    left = {
        "unfinished_episode": bool(list(folder.glob(".episode-*.partial"))),
        "unfinished_export": bool(list(folder.glob("minari/zsdist/*/.data.partial"))),
    }
    result = folder / "read.json"
    _, status = os.waitpid(forked(lambda: read_all(folder, result)), 0)
    assert status == 0, f"a finished episode in {folder} cannot be read"
    return {"after_s": round(after_s, 3), **left, **json.loads(result.read_text())}


def main() -> None:
    """Add rows until there is one for each kill, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--results", type=Path, default=Path("runs/recordings.jsonl"), help="appended to")
    options = parser.parse_args()
    warm_up()
    folder = options.results.with_suffix(".set")
    folder.mkdir(parents=True, exist_ok=True)
    rows = _rows(options.results)
    for number in range(len(rows), options.kills):
        before = rows[-1]["episodes"] if rows else 0
        row = {"kill": number, **kill_one(folder, random.Random(number), in_export=number % 2 == 1)}
        assert row["episodes"] >= before, f"of {before} finished episodes {row['episodes']} are left"
        with options.results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        print(json.dumps(row), flush=True)
        rows.append(row)
    unfinished = [sum(row[name] for row in rows) for name in ("unfinished_episode", "unfinished_export")]
    summary = {"kills": len(rows), "in_an_episode": unfinished[0], "in_an_export": unfinished[1], "unreadable": 0}
    print(json.dumps(summary | {"episodes": rows[-1]["episodes"] if rows else 0}))


def _rows(results: Path) -> list[dict]:
    return [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()] if results.exists() else []


if __name__ == "__main__":
    main()
