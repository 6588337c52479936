from zsdist.config import Config
from zsdist.pretraining.job import Job
from zsdist.pretraining.sources import shards, sources


def job(**changes):
    whole = {"images": 4000, "epochs": 0, "seed": 0, "families": ("street", "varied"), "cityscapes": ""}
    return Job(**{**whole, "stages": ("words", "head", "student"), "config": Config(), "command": "", **changes})


def test_wherever_one_stops_every_source_has_about_its_share():
    wanted = sources(job())
    order = shards(wanted)
    assert sum(shard.count for shard in order) == sum(source.pictures for source in wanted.values())
    half = order[: len(order) // 2]
    for name in ("act", "described", "masked"):
        made = sum(shard.count for shard in half if shard.source == name)
        assert 0.25 < made / wanted[name].pictures < 0.75


def test_pictures_are_made_only_for_the_stages_that_are_asked_for():
    assert set(sources(job(stages=("words",)))) == {"described", "described-validation"}
    assert set(sources(job(stages=("head",)))) == {"act", "validation"}


def test_a_job_is_read_back_as_it_was_written():
    assert Job.from_json(job().to_json()) == job()
