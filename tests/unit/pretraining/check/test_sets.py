import numpy as np
import pytest

from zsdist.config import CameraConfig
from zsdist.pretraining.check.sets import SETS, of_set, wilderness
from zsdist.sim.scenes.manifest import MANIFEST, TRAINED_GROUNDS, WITHHELD_GROUNDS, WITHHELD_KINDS

CAMERA = CameraConfig(size_px=64)


def kinds(samples):
    return {obstacle.kind for sample in samples for obstacle in sample.scene.obstacles}


def test_the_wilderness_follows_from_its_seed():
    first, again, other = (list(wilderness(16, seed, CAMERA)) for seed in (0, 0, 1))
    assert all((a.image == b.image).all() for a, b in zip(first, again, strict=True))
    assert not any((a.image == b.image).all() for a, b in zip(first, other, strict=True))


@pytest.mark.parametrize("name", SETS)
def test_a_set_has_as_many_pictures_as_asked_for_each_with_its_truth(name):
    samples = list(of_set(name, 10, 5, CAMERA))
    assert len(samples) == 10
    for sample in samples:
        assert sample.image.shape == (64, 64, 3) and sample.image.dtype == np.uint8
        near = sample.truth["ray_clearance_m"] < CAMERA.range_m
        assert (near >= (sample.objects >= 0)).all()  # every obstacle that is met is within the range


def test_sets_differ_from_training_as_their_names_say():
    trained = MANIFEST["vision-training"].kinds
    samples = {name: list(of_set(name, 32, 6, CAMERA)) for name in ("same", "new_kinds", "new_grounds", "both")}
    for name, new_ground in (("same", False), ("new_kinds", False), ("new_grounds", True), ("both", True)):
        allowed = WITHHELD_GROUNDS if new_ground else TRAINED_GROUNDS
        assert {sample.scene.ground for sample in samples[name]} <= set(allowed)
    assert kinds(samples["same"]) | kinds(samples["new_grounds"]) <= set(trained)
    assert kinds(samples["new_kinds"]) & set(WITHHELD_KINDS) and kinds(samples["both"]) & set(WITHHELD_KINDS)


def test_scenes_of_the_sets_are_of_the_test_split():
    seeds = [int(sample.scene.name.rpartition("-")[2]) for name in SETS for sample in of_set(name, 1, 7, CAMERA)]
    assert all(2_000_000 <= seed < 3_000_000 for seed in seeds)
