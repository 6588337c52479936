import json
import os
import signal
import sys

import clip_models
import numpy as np
import pytest
import torch

from zsdist import pretrain
from zsdist.common import cli
from zsdist.config import CameraConfig, VisionConfig
from zsdist.errors import RunError, WeightsError
from zsdist.pretraining import pictures
from zsdist.pretraining.progress import PretrainingProgress
from zsdist.vision import weights_folder
from zsdist.vision.encoders import DEFAULT, open_encoder
from zsdist.vision.training import head as of_head
from zsdist.vision.visual_act import VisualAct
from zsdist.vision.words.vocabulary import KIND_WORDS, Vocabulary


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
        assert command(*short, "--out", broken) == 130
    assert f"--resume {broken}" in capsys.readouterr().out
    seen = []
    with monkeypatch.context() as patched:
        patched.setattr(
            PretrainingProgress,
            "epoch",
            lambda self, *figures: seen.append(figures) or (len(seen) == 3 and interrupt()),
        )
        assert command("--resume", broken, "--workers", 2) == 130
    assert command("--resume", broken) == 0
    whole, again = weights_folder.read(tmp_path / "whole"), weights_folder.read(broken)
    for name in (
        weights_folder.HEAD_FILE,
        weights_folder.PROJECTION_FILE,
        weights_folder.STUDENT_FILE,
        weights_folder.COMPACT_FILE,
        weights_folder.VOCABULARY_FILE,
    ):
        assert whole.content(name) == again.content(name)
    assert whole.history() == again.history()
    assert [(line["stage"], line["epoch"]) for line in again.history()] == [
        (stage, epoch) for stage in ("words", "head", "student", "compact") for epoch in (1, 2)
    ]
    assert not (broken / "pictures").exists() and not (broken / "stages").exists()
    metadata = json.loads((broken / weights_folder.METADATA_FILE).read_text())
    vocabulary = Vocabulary.from_bytes(again.content(weights_folder.VOCABULARY_FILE))
    assert metadata["encoder"]["text_sha256"] == vocabulary.text_sha256 == open_encoder(DEFAULT).text_sha256
    assert metadata["seed"] == 5 and metadata["images"] == 32 and metadata["families"] == ["street", "varied"]


@pytest.mark.integration
def test_sigterm_leaves_what_is_finished_and_says_how_to_go_on_and_a_loss_of_nan_names_stage_and_epoch(
    tmp_path, monkeypatch, capsys
):
    out = tmp_path / "new"
    arguments = ["--images", "16", "--stages", "head", "--workers", "1", "--plain", "--out", str(out)]
    with monkeypatch.context() as patched:
        patched.setattr(PretrainingProgress, "epoch", lambda *figures: os.kill(os.getpid(), signal.SIGTERM))
        with pytest.raises(SystemExit) as left:
            cli.execute(pretrain.main, pretrain.make_parser(), arguments)
    assert left.value.code == 128 + signal.SIGTERM
    assert f"-m zsdist.pretrain --resume {out} " in capsys.readouterr().out.splitlines()[-1]
    real = of_head.loss
    monkeypatch.setattr(of_head, "loss", lambda *batch: (real(*batch)[0] * float("nan"), real(*batch)[1]))
    with pytest.raises(RunError, match=r"^stage 'head': loss is nan \(actions .* in epoch 2; allowed is a finite one"):
        command("--resume", out)


@pytest.mark.integration
@pytest.mark.parametrize("layout", [clip_models.of_open_clip, clip_models.hugging_face])
def test_a_clip_folder_is_trained_on_from_pictures_to_a_look_in_its_own_words(layout, tmp_path, monkeypatch):
    monkeypatch.setenv("ZSDIST_CACHE", str(tmp_path / "cache"))
    clip, out = tmp_path / "tiny-clip", tmp_path / "weights"
    clip.mkdir()
    layout(clip)
    small = ("--images", 16, "--epochs", 1, "--workers", 1, "--stages", "words,head,student")
    assert command("--encoder", clip, *small, "--out", out) == 0
    encoder, made = open_encoder(str(clip)), weights_folder.read(out)
    about = {"name": "clip/tiny-clip", "sha256": encoder.sha256, "text_sha256": encoder.text_sha256}
    assert made.metadata["encoder"] == about
    assert set(made.metadata["files"]) == {
        weights_folder.HEAD_FILE,
        weights_folder.STUDENT_FILE,
        weights_folder.VOCABULARY_FILE,
    }
    assert {line["stage"] for line in made.history()} == {"head", "student"}
    vocabulary = Vocabulary.from_bytes(made.content(weights_folder.VOCABULARY_FILE))
    words = KIND_WORDS["tree"].training
    assert np.abs(vocabulary.rows(words) - encoder.embed_texts(words)).max() < 1e-5

    model = VisualAct.load(VisionConfig(encoder=str(clip), weights=str(out)), CameraConfig())
    images = np.random.default_rng(0).integers(0, 256, (2, 64, 64, 3), np.uint8)
    look, native = model.observe(images), encoder.native_projection()
    whole = encoder.tokens(images).mean((1, 2)) @ native["weight"].T
    assert look.embeddings.shape == (2, 4, clip_models.DIMENSIONS) and look.attention.shape == (2, 3, encoder.side**2)
    assert np.abs(look.embeddings[:, 0] - whole / np.linalg.norm(whole, axis=1, keepdims=True)).max() < 1e-4
    assert np.abs(np.linalg.norm(look.embeddings, axis=-1) - 1).max() < 1e-4
    assert len(model(images, np.zeros(2), np.full(2, 5.0))) == 2
    with pytest.raises(WeightsError, match="are for the encoder 'clip/tiny-clip'"):
        VisualAct.load(VisionConfig(encoder=DEFAULT, weights=str(out)), CameraConfig())
