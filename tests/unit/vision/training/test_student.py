import math

import numpy as np
import pytest
import torch

from zsdist.vision.models import STUDENT_PX
from zsdist.vision.models.student import Student
from zsdist.vision.rays import BIN_CENTRES_M, BINS, RANGE_M, RAYS, ray_angles_rad, soft_labels
from zsdist.vision.training import student as training
from zsdist.vision.training.examples import Examples, targets
from zsdist.vision.training.head import new_head, validate
from zsdist.vision.training.student import (
    TeacherPredictions,
    augment_images,
    mix_labels,
    new_student,
    predict_with_teacher,
    with_image_tokens,
)
from zsdist.vision.training.trainer import Recipe

ANGLES = ray_angles_rad(RAYS, math.pi / 2)
QUICK = Recipe(epochs=3, batch=8)


def examples(count, seed):
    """Return examples in which a column is brighter the nearer its obstacle is."""
    rng = np.random.default_rng(seed)
    distance = np.where(rng.random((count, 4)) < 0.4, RANGE_M, rng.uniform(0.3, RANGE_M, (count, 4)))
    distance = distance.repeat(RAYS // 4, 1).astype(np.float32)
    bright = (40 + 40 * (RANGE_M - distance)).repeat(STUDENT_PX // RAYS, 1)
    images = np.broadcast_to(bright[:, None, :, None], (count, STUDENT_PX, STUDENT_PX, 3)).astype(np.uint8)
    tokens = rng.standard_normal((count, 8, 8, 6)).astype(np.float16)
    return Examples(tokens, distance, rng.random((count, RAYS)) < 0.2, ANGLES, images)


def small():
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return Student(math.pi / 2, (4, 6, 8, 8), 16)


def history(network, teacher=None, recipe=QUICK):
    data = examples(48, 0)
    return list(training.train(network, data, examples(16, 1), recipe, np.random.default_rng(0), lambda: 0.0, teacher))


def oracle(data):
    """Return predictions that put all probability on the true bin."""
    one_hot = np.eye(BINS, dtype=np.float16)
    bins = np.abs(np.log(BIN_CENTRES_M) - np.log(data.ray_distance_m)[..., None]).argmin(-1)
    clearance, dynamic = one_hot[np.zeros((len(data), 3), int)], np.zeros((len(data), 3), np.float16)
    return TeacherPredictions(clearance, dynamic, one_hot[bins])


def test_training_lowers_the_loss_on_pictures_it_has_not_seen():
    network, unseen = small(), with_image_tokens(examples(16, 2))
    before = validate(network, unseen, 16)
    figures = history(network, recipe=Recipe(epochs=6, batch=8))
    after = validate(network, unseen, 16)
    assert after["rays"] < 0.8 * before["rays"] and sum(after.values()) < sum(before.values())
    assert {"epoch", "learning_rate", "loss", "validation_loss", "validation_rays"} <= set(figures[-1])


def test_training_repeats_exactly_with_its_seed():
    first, second = small(), small()
    assert history(first, recipe=Recipe(epochs=1, batch=8)) == history(second, recipe=Recipe(epochs=1, batch=8))
    for name, value in first.state_dict().items():
        assert torch.equal(value, second.state_dict()[name])


def test_the_teacher_predicts_what_the_head_outputs_for_the_same_examples():
    data = examples(5, 3)
    head = new_head(data, math.pi / 2, 0)
    teacher = predict_with_teacher(head, data, batch=2)
    rays = head(torch.from_numpy(data.tokens.astype(np.float32))).rays.softmax(-1)
    np.testing.assert_allclose(teacher.rays, rays.detach(), atol=1e-3)
    assert teacher.clearance.shape == (5, 3, BINS) and teacher.dynamic.shape == (5, 3)


def test_predictions_of_the_teacher_change_the_result_of_the_training():
    alone, with_teacher = history(small()), history(small(), oracle(examples(48, 0)))
    assert alone[-1]["validation_loss"] != with_teacher[-1]["validation_loss"]


def test_a_mixed_label_lies_between_truth_and_prediction_and_is_mirrored_with_its_picture():
    data, index = with_image_tokens(examples(4, 3)), np.arange(4)
    shapes = ((4, 3, BINS), (4, 3), (4, RAYS, BINS))
    teacher = TeacherPredictions(*(np.random.default_rng(0).random(shape).astype(np.float16) for shape in shapes))
    for mirrored in (False, True):
        batch = targets(data, index, np.full(4, mirrored), np.random.default_rng(0))
        mixed = mix_labels(batch, teacher, index, np.full(4, mirrored))
        sides = [0, 2, 1] if mirrored else [0, 1, 2]
        predicted = teacher.rays[:, ::-1] if mirrored else teacher.rays
        share = training.TEACHER_SHARE
        np.testing.assert_allclose(mixed.rays, (1 - share) * batch.rays.numpy() + share * predicted, atol=1e-3)
        np.testing.assert_allclose(
            mixed.clearance,
            (1 - share) * batch.clearance.numpy() + share * teacher.clearance[:, sides],
            atol=1e-3,
        )
        np.testing.assert_allclose(
            mixed.dynamic, (1 - share) * batch.dynamic.numpy() + share * teacher.dynamic[:, sides], atol=1e-3
        )
        assert torch.equal(mixed.reward, batch.reward) and torch.equal(mixed.present, batch.present)


def test_a_mirrored_picture_has_mirrored_labels():
    data = with_image_tokens(examples(3, 4))
    plain, mirrored = (
        targets(data, np.arange(3), np.full(3, flip), np.random.default_rng(0)) for flip in (False, True)
    )
    assert torch.equal(mirrored.tokens, plain.tokens.flip(2)) and torch.equal(mirrored.rays, plain.rays.flip(1))
    np.testing.assert_allclose(plain.rays, soft_labels(data.ray_distance_m))


def test_each_picture_is_augmented_differently_and_stays_in_the_range_of_bytes():
    with torch.random.fork_rng():
        torch.manual_seed(0)
        images = torch.full((6, 32, 32, 3), 100.0)
        changed = augment_images(images)
    means, spreads = changed.mean((1, 2)), changed.std((1, 2)).mean(-1)
    assert means.std(0).min() > 3 and means.std(1).min() > 0.5 and len(set(spreads.tolist())) == 6
    assert changed.min() >= 0 and changed.max() <= 255 and torch.equal(images, torch.full_like(images, 100.0))


def test_examples_without_their_pictures_are_refused():
    bare = Examples(np.zeros((1, 2, 2, 3), np.float16), np.ones((1, RAYS)), np.zeros((1, RAYS), bool), ANGLES)
    with pytest.raises(ValueError, match="examples are without their pictures"):
        training.train(small(), bare, bare, QUICK, np.random.default_rng(0), lambda: 0.0)


def test_a_new_student_follows_from_its_seed_and_leaves_the_global_generator_alone():
    state = torch.random.get_rng_state()
    first, again, other = (new_student(math.pi / 2, seed).state_dict()["keys.weight"] for seed in (0, 0, 1))
    assert torch.equal(first, again) and not torch.equal(first, other)
    assert torch.equal(torch.random.get_rng_state(), state)
