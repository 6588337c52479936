import json

import pytest
from recordings import SIMULATION, recorded

from zsdist import record
from zsdist.common import cli
from zsdist.evaluation import recorded_drives
from zsdist.recording.recorded_set import RecordedSet

SMALL = ("--scenes", "singleton", "--workers", "1", "--set", "sim.max_steps=20")


@pytest.fixture
def kinematic(monkeypatch):
    """Let the command drive kinematic cars."""

    def job(contender, manifest, folder, seed):
        return recorded_drives.RecordingJob(contender, manifest, folder, seed, SIMULATION)

    monkeypatch.setattr(record, "RecordingJob", job)


def run(*words):
    with pytest.raises(SystemExit) as exit_:
        cli.execute(record.main, record.make_parser(), [str(word) for word in words])
    return exit_.value.code


def test_a_set_is_recorded_resumed_and_then_complete(kinematic, tmp_path, capsys):
    out = tmp_path / "sets" / "one"
    assert run("astar-vision", *SMALL, "--episodes", 2, "--out", out) == 0
    assert f"set: {out} (2 episodes)" in capsys.readouterr().out
    first = {path: path.read_bytes() for path in RecordedSet(out).episodes().values()}
    assert run("astar-vision", *SMALL, "--episodes", 3, "--out", out, "--resume") == 0
    assert "2 episodes are in" in capsys.readouterr().out
    assert {path: path.read_bytes() for path in first} == first and len(RecordedSet(out).episodes()) == 3
    assert run("astar-vision", *SMALL, "--episodes", 3, "--out", out, "--resume") == 0


def test_a_set_that_was_recorded_without_minari_is_exported_later(kinematic, tmp_path):
    minari = pytest.importorskip("minari")
    assert run("random", *SMALL, "--episodes", 2, "--out", tmp_path / "set") == 0
    assert run("random", *SMALL, "--episodes", 2, "--out", tmp_path / "set", "--resume", "--format", "minari") == 0
    found = minari.MinariDataset(tmp_path / "set" / "minari" / "zsdist" / "random-singleton-v0" / "data")
    assert found.total_episodes == 2 and json.loads((tmp_path / "set" / "set.json").read_text())["pictures"] == "jpeg"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["random"], "--out is missing"),
        (["--out", "DIR"], "no policy was named"),
        (["random", "--out", "DIR", "--resume"], "holds no set"),
        (["random", "--out", "SET"], "holds a set already"),
        (["random", "--out", "SET", "--resume"], "recorded with"),
        (["astar-vision", *SMALL, "--out", "SET", "--resume", "--seed", "1"], "seed 0 and this is 1"),
        (["random", "--out", "FILE"], "is a file"),
        (["random", "--repair", "FILE"], "--repair takes no POLICY"),
        (["--repair", "DIR"], "which is not a file"),
        (["--repair", "FILE"], "is not the beginning of an MCAP file"),
        (["nobody", "--out", "DIR"], "nobody"),
    ],
)
def test_what_cannot_be_done_is_one_line(tmp_path, capsys, words, said):
    (tmp_path / "file").write_text("text")
    if "SET" in words:
        recorded(tmp_path / "set", 1)
    places = {"DIR": tmp_path / "new", "SET": tmp_path / "set", "FILE": tmp_path / "file"}
    assert run(*(places.get(word, word) for word in words)) == 2
    (line,) = capsys.readouterr().err.splitlines()[-1:]
    assert said in line and "zsdist.record: error: " in line
    assert not (tmp_path / "new").exists() or "nobody" in words
