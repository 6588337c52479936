import json
import sys

import pytest
import torch

from zsdist import cli, pretrain
from zsdist.pretraining import pictures
from zsdist.pretraining.progress import Watch
from zsdist.vision import folder
from zsdist.vision.words.vocabulary import Vocabulary


@pytest.fixture(autouse=True)
def without_the_check_on_one_thread(monkeypatch):
    monkeypatch.setattr(pretrain, "check", lambda *arguments, **options: None)
    monkeypatch.setattr(sys, "argv", ["pretrain", "--images", "32"])
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def command(*arguments):
    return pretrain.main(pretrain.make_parser().parse_args([str(argument) for argument in arguments]))


def interrupt(*arguments):
    raise KeyboardInterrupt


@pytest.mark.integration
def test_a_pretraining_that_was_broken_off_twice_ends_with_the_weights_of_one_that_was_not(
    tmp_path, monkeypatch, capsys
):
    short = ("--images", 32, "--epochs", 2, "--seed", 5, "--workers", 1)
    assert command(*short, "--out", tmp_path / "whole") == 0
    broken = tmp_path / "broken"
    with monkeypatch.context() as patched:
        patched.setattr(pictures, "make", interrupt)
        assert command(*short, "--out", broken) == cli.INTERRUPTED
    assert f"--resume {broken}" in capsys.readouterr().out
    seen = []
    with monkeypatch.context() as patched:
        patched.setattr(Watch, "epoch", lambda self, *figures: seen.append(figures) or (len(seen) == 3 and interrupt()))
        assert command("--resume", broken, "--workers", 2) == cli.INTERRUPTED
    assert command("--resume", broken) == 0
    whole, again = folder.read(tmp_path / "whole"), folder.read(broken)
    for name in (folder.HEAD_FILE, folder.PROJECTION_FILE, folder.STUDENT_FILE):
        assert whole.content(name) == again.content(name)
    first, second = (Vocabulary.from_bytes(made.content(folder.VOCABULARY_FILE)) for made in (whole, again))
    assert first.words == second.words and (first.embeddings == second.embeddings).all()
    assert whole.history() == again.history()
    assert [(line["stage"], line["epoch"]) for line in again.history()] == [
        (stage, epoch) for stage in ("words", "head", "student") for epoch in (1, 2)
    ]
    assert not (broken / "pictures").exists() and not (broken / "stages").exists()
    metadata = json.loads((broken / folder.METADATA_FILE).read_text())
    assert metadata["seed"] == 5 and metadata["images"] == 32 and metadata["families"] == ["street", "varied"]
