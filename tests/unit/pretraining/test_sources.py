import numpy as np

from zsdist.config import CameraConfig, Config
from zsdist.datasets import masked
from zsdist.pretraining.job import Job
from zsdist.pretraining.sources import PictureShard, make, scene_numbers, shards, sources


def job(**changes):
    whole = {"images": 4000, "epochs": 0, "seed": 0, "families": ("street", "varied"), "cityscapes": ""}
    return Job(**{**whole, "stages": ("words", "head", "student"), "config": Config(), "command": "", **changes})


def test_every_source_advances_evenly_so_that_work_may_stop_anywhere():
    wanted = sources(job())
    order = shards(wanted)
    assert sum(shard.count for shard in order) == sum(source.pictures for source in wanted.values())
    half = order[: len(order) // 2]
    for name in ("act", "described", "masked"):
        made = sum(shard.count for shard in half if shard.source == name)
        assert 0.25 < made / wanted[name].pictures < 0.75


def test_pictures_are_made_only_for_the_wanted_stages():
    assert set(sources(job(stages=("words",)))) == {"described", "described-validation"}
    assert set(sources(job(stages=("head",)))) == {"act", "validation"}


class MeanColours:
    """Encoder whose tokens are the mean colours of 8 x 8 parts."""

    def tokens(self, images):
        part = images.shape[1] // 8
        return images.reshape(-1, 8, part, 8, part, 3).mean((2, 4), dtype=np.float32)


def test_masked_pictures_follow_their_original_with_its_scene_and_differ_where_they_are_hidden(monkeypatch):
    made, real = [], masked.masked_view
    monkeypatch.setattr(masked, "masked_view", lambda *arguments: made.append(real(*arguments)) or made[-1])
    small = job(config=Config(camera=CameraConfig(size_px=64)))
    arrays = make(small, PictureShard("masked", 0, 10), MeanColours())
    whole = np.flatnonzero(arrays["original"] < 0)
    assert len(whole) == len(made) == 10 and len(np.unique(arrays["scene"])) == 2
    assert (arrays["scene"][whole] == scene_numbers(view.scene_hash for view in made)).all()
    for number, (first, view) in enumerate(zip(whole, made, strict=True)):
        rows = slice(first + 1, first + 1 + len(view.masks))
        assert (arrays["original"][rows] == number).all() and (arrays["scene"][rows] == arrays["scene"][first]).all()
        assert arrays["background"][rows].tolist() == [mask.background for mask in view.masks]
        for mask, tokens in zip(view.masks, arrays["tokens"][rows], strict=True):
            touched = mask.hidden.reshape(8, 8, 8, 8).any((1, 3))
            assert (tokens == arrays["tokens"][first])[~touched].all()
            assert (tokens != arrays["tokens"][first])[touched].any()


def test_a_job_is_read_back_as_it_was_written():
    assert Job.from_json(job().to_json()) == job()
