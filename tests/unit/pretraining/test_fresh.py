import contextlib
import itertools

import numpy as np
import pytest

from zsdist.config import Config
from zsdist.pretraining import fresh
from zsdist.pretraining.job import Job
from zsdist.vision.models import COMPACT_PX, COMPACT_ROWS
from zsdist.vision.rays import RAYS


@pytest.fixture
def job(monkeypatch):
    """Return a job with epochs of two shards, of 4 and 2 pictures."""
    monkeypatch.setattr(fresh, "SHARD", 4)
    return Job(6, 0, 3, ("street", "varied"), "", ("compact",), Config(), "")


def drawn(job, first, count):
    with contextlib.closing(fresh.epochs(job, 1, first)) as epochs:
        return list(itertools.islice(epochs, count))


def test_epochs_have_new_pictures_that_do_not_depend_on_where_the_training_began(job):
    first, second = drawn(job, 0, 2)
    (again,) = drawn(job, 1, 1)
    assert first.tokens.shape == second.tokens.shape == (6, COMPACT_ROWS, COMPACT_PX, 3)
    assert first.ray_distance_m.shape == first.ray_dynamic.shape == (6, RAYS)
    np.testing.assert_array_equal(second.tokens, again.tokens)
    np.testing.assert_array_equal(second.ray_distance_m, again.ray_distance_m)
    assert len({picture.tobytes() for epoch in (first, second) for picture in epoch.tokens}) == 12


def test_pictures_of_the_validation_are_others(job):
    (first,) = drawn(job, 0, 1)
    unseen = fresh.validation(job)
    assert len(unseen) == 6
    assert not {picture.tobytes() for picture in unseen.tokens} & {picture.tobytes() for picture in first.tokens}


def test_an_epoch_has_no_more_pictures_than_the_head_is_trained_on(job):
    assert fresh.epoch_pictures(job) == 6
    assert fresh.epoch_pictures(Job(10**6, 0, 3, (), "", ("compact",), Config(), "")) == fresh.EPOCH
