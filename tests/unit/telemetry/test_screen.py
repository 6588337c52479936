import io
from itertools import pairwise

import pytest
from made_snapshots import alive, extreme, made, report

from zsdist.common.console import PlainConsole
from zsdist.telemetry.curves import CurveHistory
from zsdist.telemetry.screen import RunScreen, lines
from zsdist.telemetry.snapshot import Snapshot
from zsdist.telemetry.view import Clock, view_of

SIZES = [(80, 24), (120, 40), (160, 50), (200, 60)]
ESSENTIAL = ["demo", "20 of 50 episodes", "about 3 min 00 s left", "stage train", "waiting nothing", "success 0.40",
             "restarts 0", "roles alive", "env steps/s", "weight lag", "merges 2", "replay", "actor-1 has joined",
             "✕ actor-3", "learner-low", "success, last 50 episodes", "⣀"]  # fmt: skip


def view():
    """Return a run of eight actors, one of them silent."""
    names = [("scheduler", "0"), ("learner", "high"), ("learner", "low"), ("replay", "0"), ("hub", "0")]
    names += [("actor", str(number)) for number in range(8)]
    progress = {"stage": "train", "episodes": 20, "episodes_target": 50, "merges": 2, "recent_success": 0.4}
    snapshot = made(
        *(report(*name, **(progress if name[0] == "scheduler" else {"env_steps": 9, "cars": 2})) for name in names),
        *(alive(*name) for name in names),
    )
    figures = {"time_s": [], "episodes": [], "recent_success": [], "mean_return": []}
    for episode in range(21):
        for name, value in zip(figures, (6.0 * episode, episode, episode**2 / 1000, -episode), strict=True):
            figures[name].append(value)
    said = ["actor-1 has joined the run"]
    silent_s = {("actor", "3"): 12.0}
    return view_of("demo", snapshot, Clock(120.0), history=CurveHistory(figures), silent_s=silent_s, notices=said)


@pytest.fixture(scope="module")
def strange():
    """Return a run that has said nothing, and one of 4,096 actors."""
    return [view_of("r" * 64, made(), Clock(10.0**7), notices=["n" * 500]) for made in (Snapshot, extreme)]


def printed(shown, width, height):
    output = io.StringIO()
    PlainConsole(file=output, width=width, height=height).print(RunScreen(shown))
    return output.getvalue()


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_a_screen_is_full_and_shows_what_is_essential(width, height):
    text = printed(view(), width, height)
    assert [len(line) for line in text.splitlines()] == [width] * height
    assert [word for word in ESSENTIAL if word not in text] == []


def test_a_larger_screen_shows_more():
    screens = [printed(view(), width, height) for width, height in SIZES]
    dots = [sum("\u2800" < character <= "\u28ff" for character in screen) for screen in screens]
    roles = [sum(f"actor-{number} " in screen for number in range(8)) for screen in screens]
    assert all(more > less for less, more in pairwise(dots))
    assert roles[0] < roles[1] == 8 and "loss low" not in screens[0] and "loss low" in screens[2]


@pytest.mark.parametrize(("width", "height"), [*SIZES, (40, 12), (20, 5), (1, 1), (300, 8)])
def test_any_run_fits_into_any_terminal(width, height, strange):
    for shown in strange:
        made_lines = lines(shown, width, height)
        assert len(made_lines) == height and {line.cell_len for line in made_lines} == {width}


def test_texts_of_peers_are_shown_as_they_are():
    shown = view_of("demo", Snapshot(), Clock(0.0), notices=["[red]\x1b[2J"])
    assert "[red]\\x1b[2J" in printed(shown, 80, 24)
