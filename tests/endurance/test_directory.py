"""The run directory over a month: a row of figures a second, 100,000 episodes, resumes; what its files take."""

import json
import time

import numpy as np
import pytest
from endurance.conftest import DAY_S, MIB

from zsdist import config
from zsdist.run import directory
from zsdist.run.directory import RunDirectory
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire.messages import State

VISION = VisionIdentity("clip/b", "a" * 64, "head", "b" * 64)
FIELDS = 68  # as many as a distributed run has, with names and figures as long
EPISODE = {
    **{f"return_of_a_kind_{number}": -123.4567 for number in range(30)},
    "scene": "iid-000123",
    "outcome": "success",
    "path": [[-7.81, 3.44]] * 60,
}
ARRAYS = {"ring": np.zeros((1000, 64), np.float32)}
STATES = {
    "replay": State("replay", {}, ARRAYS),
    **{f"learner-{level}": State(level, {}, ARRAYS) for level in ("a", "b")},
}


def bytes_of(folder):
    sizes = {}
    for path in folder.rglob("*"):
        if path.is_file():
            part = path.relative_to(folder).parts[0]
            sizes[part] = sizes.get(part, 0) + path.stat().st_size
    return sizes


FIGURES = {f"replay_high_figure_{number:02d}": 1234567891 + number for number in range(FIELDS - 3)}


def row(second, episodes):
    return {"time_s": 1.7e9 + second, "episodes": episodes, "env_steps": 40 * episodes, **FIGURES}


@pytest.mark.timeout(3600)
def test_a_month_of_files_stays_small_and_is_rewound_in_moments(tmp_path, span, growth, report):
    folder = directory.create(tmp_path / "run", config.Config())
    run_log, finished, sizes, rewinds_s, began_s = RunDirectory(folder, VISION), 0, [], [], time.monotonic()
    every_s = DAY_S * span.days / span.episodes
    for second in range(span.days * DAY_S):
        if second >= (finished + 1) * every_s:
            finished += 1
            run_log.episode(
                EPISODE | {"episode": finished, "return": -1.0, "steps": 60, "epsilon": 0.1, "finished_as": finished}
            )
            if finished % 500 == 0:
                scheduler = State("scheduler", {"finished": list(range(1, finished + 1))}, {})
                run_log.checkpoint(finished, STATES | {"scheduler": scheduler})
        run_log.metrics(row(second, finished))
        if (second + 1) % (DAY_S // 2) == 0:
            growth.note(second / DAY_S)
            sizes.append(bytes_of(folder))
        if (second + 1) % (5 * DAY_S) == 0 and second + 1 < span.days * DAY_S:
            before_s = time.monotonic()
            directory.rewind(folder, *directory.reopen(folder))
            rewinds_s.append(time.monotonic() - before_s)
            run_log, finished = RunDirectory(folder, VISION), finished // 500 * 500
    a_day = {name: size / MIB / span.days for name, size in sizes[-1].items() if size > MIB / 100}
    first_day = sum(sizes[1].values()) / MIB
    report(
        disk_mib_a_day=sum(a_day.values()),
        disk_mib_first_day=first_day,
        memory_mib_a_day=growth.mib_a_day,
        slowest_rewind_s=max(rewinds_s, default=0.0),
        took_s=time.monotonic() - began_s,
        **a_day,
    )
    assert first_day < 20
    assert sum(a_day.values()) < 20
    assert growth.mib_a_day < 1
    lines = (folder / "metrics.jsonl").read_text().splitlines()
    rows = [json.loads(line) for line in lines]
    assert [one["episodes"] for one in rows] == sorted(one["episodes"] for one in rows)
    assert rows[0]["time_s"] == 1.7e9 and rows[-1]["time_s"] == 1.7e9 + span.days * DAY_S - 1
    assert sum(1 for _ in (folder / "episodes.jsonl").open()) == finished


@pytest.mark.parametrize("days", [1, 30])
def test_a_rewind_reads_little_of_a_long_run(tmp_path, days):
    folder = directory.create(tmp_path / "run", config.Config())
    run_log = RunDirectory(folder, VISION)
    count = 1000 * days
    (folder / "episodes.jsonl").write_text(
        "".join(json.dumps({"episode": number, "finished_as": number}) + "\n" for number in range(1, count + 11))
    )
    run_log.checkpoint(count, STATES | {"scheduler": State("scheduler", {"finished": list(range(1, count + 1))}, {})})
    directory.rewind(folder, *directory.reopen(folder))
    assert sum(1 for _ in (folder / "episodes.jsonl").open()) == count
