import dataclasses
import json
import random
from functools import partial

import numpy as np
import pytest
from fakes import LatticeEnv
from rehearsal import SMALL, episodes, kinematic, rehearse, resume, start

from zsdist import config
from zsdist.run import checkpoint_files, sittings
from zsdist.wire.messages import State

SHORT = (
    "run.cars_per_actor=1",
    "run.episodes=6",
    "run.checkpoint_every_episodes=2",
    "sim.max_steps=14",
    "merge.every_episodes=3",
    "merge.validation_scenes=1",
    "merge.drive_steps=8",
    "low.min_size=16",
    "low.updates_per_insert=2",
    "vision.cache_bytes=0",
)


def settings(**changed):
    return config.load(None, (*SMALL, *(f"{section}={value}" for section, value in changed.items())))


def states(finished, merged=None):
    merges = [] if merged is None else [{"episode": merged}]
    return {"scheduler": State("scheduler", {"finished": list(range(1, finished + 1)), "merges": merges}, {})}


@pytest.mark.parametrize(
    ("finished", "merged", "every", "merge_every", "target", "end"),
    [
        (0, None, 50, 0, 100, sittings.LONGEST),
        (0, None, 3, 0, 100, 3),
        (4, None, 3, 0, 100, 6),  # as from any other place
        (9, None, 3, 0, 11, 11),
        (0, None, 50, 7, 100, 7),
        (7, 7, 50, 7, 100, sittings.LONGEST),
        (9, None, 3, 0, 9, 9),
        (12, None, 50, 7, 100, 12),  # merges have been switched on since, and one is overdue
    ],
)
def test_a_sitting_ends_at_a_multiple_at_a_merge_or_at_the_end_of_the_run(
    finished, merged, every, merge_every, target, end
):
    run = {"run": f"{{checkpoint_every_episodes: {every}, episodes: {target}}}"}
    made = settings(**run, **{"merge.every_episodes": merge_every})
    assert sittings.end(made, states(finished, merged)) == end


def test_the_first_sitting_drives_nothing():
    assert sittings.end(settings(), {}) == 0


def test_a_run_is_complete_after_its_last_episode_and_the_merge_that_is_due():
    made = settings(**{"run.episodes": 8, "merge.every_episodes": 4})
    assert not sittings.is_complete(made, {})
    assert not sittings.is_complete(made, states(7, 4))
    assert not sittings.is_complete(made, states(8, 4))
    assert sittings.is_complete(made, states(8, 8))


class Killed(BaseException):
    """End of a process in the middle of an action."""


class Stops:
    """Cars that count the actions of a run, and do something at one of them."""

    def __init__(self, at=None, act=lambda: None):
        self.actions, self._at, self._act = 0, at, act

    def into(self, spec):
        stops = self

        class Env(LatticeEnv):
            def step(self, action):
                stops.actions += 1
                if stops.actions == stops._at:
                    stops._act()
                return super().step(action)

        def make_parts(settings):
            return dataclasses.replace(kinematic(settings), make_env=lambda: Env(config=settings))

        return dataclasses.replace(spec, make_parts=make_parts)


def bits(folder):
    """Everything in a run directory that does not depend on real time or on random epochs."""
    found = {"episodes.jsonl": (folder / "episodes.jsonl").read_text()}
    rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    found["metrics.jsonl"] = [{key: row[key] for key in row if key != "ledger_bytes"} for row in rows]  # it has epochs
    summary = json.loads((folder / "summary.json").read_text())
    found["summary"] = {
        name: value for name, value in summary.items() if name not in ("wall_s", "rates", "ended_unix_s")
    }
    for checkpoint in checkpoint_files.checkpoints(folder):
        for name, state in checkpoint_files.read_checkpoint(checkpoint).items():
            meta = {key: value for key, value in state.meta.items() if key != "wall_s"}
            for level in ("high", "low") if name.startswith("replay") else ():
                streams = meta[level]["inbox"]["current"].values()
                meta[level] = {key: value for key, value in meta[level].items() if key not in ("epochs", "closed")}
                meta[level]["learner"] = meta[level]["learner"][1:]  # without its epoch
                assert all(stream.pop("epoch") for stream in streams)
            arrays = {key: (array.dtype.str, array.shape, array.tobytes()) for key, array in state.arrays.items()}
            found[checkpoint.name, name] = (meta, arrays)
    return found


def differing(one, other):
    return [key for key in one.keys() | other.keys() if one.get(key) != other.get(key)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Run that is never stopped: its bits, the number of its actions, and of those before its first merge."""
    folder, stops = tmp_path_factory.mktemp("runs") / "whole", Stops()
    rehearse(stops.into(start(folder, *SHORT)))
    return bits(folder), stops.actions, sum(record["steps"] for record in episodes(folder)[:3])


def chosen(place, actions, before_merge):
    return {
        "first action": 1,
        "within an option": 5,
        "within a merge": before_merge + 3,
        "last action": actions,
        "anywhere": random.Random(0).randrange(1, actions),
    }[place]


PLACES = ("first action", "within an option", "within a merge", "last action", "anywhere")


@pytest.mark.parametrize("place", PLACES)
def test_a_run_killed_at_any_action_and_resumed_ends_in_the_same_bits(tmp_path, whole, place):
    def kill():
        raise Killed

    expected, *counts = whole
    folder = tmp_path / "run"
    with pytest.raises(Killed):
        rehearse(Stops(chosen(place, *counts), kill).into(start(folder, *SHORT)))
    assert rehearse(resume(folder))["ended"] == "complete"
    assert differing(bits(folder), expected) == []


def test_a_run_interrupted_again_and_again_ends_in_the_same_bits(tmp_path, whole):
    folder, (expected, actions, before_merge), asked = tmp_path / "run", whole, []
    rng, spec, stopped = random.Random(1), start(folder, *SHORT), 0
    for at in (1, before_merge + 2, *(rng.randrange(1, actions // 2) for _ in range(2))):
        asked.clear()
        summary = rehearse(Stops(at, partial(asked.append, at)).into(spec), interrupted=lambda: bool(asked))
        stopped += summary["ended"] == "interrupted"
        for counts in summary["transitions"].values():
            assert counts["produced"] == counts["stored"] + counts["rejected"]
        assert summary["episodes"] == len(episodes(folder)) == sum(summary["outcomes"].values())
        spec = resume(folder)
    assert stopped == 4
    assert rehearse(spec)["ended"] == "complete"
    assert differing(bits(folder), expected) == []


def test_an_interruption_before_the_first_checkpoint_awaits_it_and_tells_what_is_driven_again(tmp_path):
    folder, stops = tmp_path / "run", Stops()
    summary = rehearse(stops.into(start(folder, *SHORT)), interrupted=lambda: True)
    assert (summary["ended"], summary["episodes"], summary["driven_again"]) == ("interrupted", 0, 2)
    assert checkpoint_files.newest_checkpoint(folder).name == "00000000"
    assert not np.array(list(summary["outcomes"].values())).any()


def test_a_run_killed_after_its_last_checkpoint_is_concluded_by_its_resumption(tmp_path, whole):
    folder, (expected, *_) = tmp_path / "run", whole
    rehearse(start(folder, *SHORT))
    (folder / "summary.json").unlink()
    stops = Stops()
    assert rehearse(stops.into(resume(folder)))["ended"] == "complete"
    assert stops.actions == 0
    assert differing(bits(folder), expected) == []
