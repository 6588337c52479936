import math

import numpy as np
import torch

from zsdist.vision.masks import MaskedExamples
from zsdist.vision.models.head import VisualActHead
from zsdist.vision.models.projection import Projection
from zsdist.vision.rays import RANGE_M, RAYS, ray_angles_rad
from zsdist.vision.training import contrast as module
from zsdist.vision.training.contrast import Contrast, attention_targets, mask_coverage
from zsdist.vision.training.examples import Examples

SIDE, FEATURES = 8, 6
ANGLES = ray_angles_rad(RAYS, math.pi / 2)
THING, GROUND = 0, 1  # number of features
COLUMNS = {"left": 0, "ahead": 3, "right": 6}
GOAL = np.array([0.0]), np.array([6.0])


def world():
    """Return pictures with objects at the left, ahead or at the right, and masks of each object and of the ground."""
    rng = np.random.default_rng(0)
    tokens, distance, masked, image, without, background = [], [], [], [], [], []
    for number in range(24):
        picture = 0.05 * rng.standard_normal((SIDE, SIDE, FEATURES))
        picture[5:, :, GROUND] += 1.0
        rays = np.full(RAYS, RANGE_M, np.float32)
        places = [column for column in COLUMNS.values() if rng.random() < 0.8] or [0]
        for column in places:
            picture[2:5, column : column + 2, THING : THING + 1] += 1.0
            picture[2:5, column : column + 2, 2 + column // 3] += 1.0
            rays[4 * column : 4 * column + 8] = 1.0
        tokens.append(picture)
        distance.append(rays)
        for column in places:
            rest, far = picture.copy(), rays.copy()
            rest[2:5, column : column + 2] = 0.0
            far[4 * column : 4 * column + 8] = RANGE_M
            masked.append(rest), without.append(far), image.append(number), background.append(False)
        rest = picture.copy()
        rest[5:] = 0.0
        masked.append(rest), without.append(rays), image.append(number), background.append(True)

    def still(rows):
        return np.zeros((len(rows), RAYS), bool)

    originals = Examples(np.array(tokens, np.float16), np.array(distance), still(tokens), ANGLES)
    return originals, MaskedExamples(
        np.array(masked, np.float16), np.array(image), np.array(without), still(masked), np.array(background)
    )


def new_head():
    torch.manual_seed(0)
    return VisualActHead(FEATURES, SIDE, math.pi / 2, width=16, column_width=16, heads=2)


def share_on_things(head, originals):
    """Return the mean share of an action's attention that is on objects."""
    tokens = torch.from_numpy(originals.tokens.astype(np.float32))
    things = (tokens[..., THING] > 0.5).flatten(1)
    with torch.no_grad():
        found = (head(tokens).attention * things[:, None]).sum(-1)
    return float(found.mean())


def trained_share(form):
    originals, masked = world()
    contrast, head, rng = Contrast(torch.nn.Identity(), originals, masked, form), new_head(), np.random.default_rng(1)
    optimiser, before = torch.optim.Adam(head.parameters(), 3e-3), share_on_things(head, originals)
    for _ in range(60):
        optimiser.zero_grad()
        contrast.loss(head, rng).backward()
        optimiser.step()
    return before, share_on_things(head, originals)


def test_the_difference_form_draws_attention_to_obstacles_and_the_literal_form_less(monkeypatch):
    monkeypatch.setattr(module, "ATTENTION_WEIGHT", 0.0)
    before, after = trained_share("difference")
    assert after > 2 * before and after > 1.5 * trained_share("literal")[1]


def test_the_projection_is_not_trained():
    projection, head = Projection(FEATURES, 10), new_head()
    Contrast(projection, *world()).loss(head, np.random.default_rng(0)).backward()
    assert all(parameter.grad is None for parameter in projection.parameters())
    assert head.attention.gaze.grad.abs().sum() > 0


def test_an_object_is_a_positive_sample_for_its_direction_and_the_ground_for_none():
    originals, masked = world()
    contrast = Contrast(torch.nn.Identity(), originals, masked)
    rows = np.flatnonzero(masked.image == 3)[None]
    positive, present = contrast.samples(np.array([3]), np.append(rows, -1)[None], *GOAL)
    assert present.tolist() == [[True] * rows.size + [False]]
    gone = (masked.ray_distance_m[rows[0]] != originals.ray_distance_m[3]).any(1)
    assert gone.sum() == rows.size - 1
    assert (positive[0].any(0) == np.append(gone, False)).all()


def test_the_loss_depends_on_its_random_numbers_alone():
    contrast, head = Contrast(Projection(FEATURES, 10), *world(), batch=8), new_head()
    first, again, other = (float(contrast.loss(head, np.random.default_rng(seed)).detach()) for seed in (0, 0, 1))
    assert first == again != other


def test_a_token_is_covered_by_the_mask_that_changed_it():
    originals, masked = world()
    found = mask_coverage(originals.tokens, masked).reshape(-1, SIDE, SIDE)
    grounds = found[masked.background]
    assert grounds[:, 5:].min() > 0.2 and grounds[:, :5].max() == 0.0
    things = found[~masked.background]
    assert (things[:, :2] == 0).all() and (things[:, 5:] == 0).all() and (things.max((1, 2)) == 1.0).all()


def test_attention_targets_are_relevant_objects_or_else_the_sky_and_never_empty_ground():
    side = 4
    cover = np.zeros((1, 3, side, side), np.float32)
    cover[0, 0, 1:3, 1] = 1.0  # an object that stands on the ground
    cover[0, 1, 2:] = 1.0  # the ground
    cover[0, 2, :2] = 1.0  # the sky
    positive = np.zeros((1, 3, 3), bool)
    positive[0, 1, 0] = True  # the object blocks the second action
    wanted, unwanted = attention_targets(cover, positive, np.array([[False, True, True]]))
    wanted, unwanted = wanted.reshape(3, side, side), unwanted.reshape(side, side)
    assert (wanted[1] == cover[0, 0]).all()
    assert wanted[0, 0].all() and wanted[0, 1, 1] == 0.0 and (wanted[0] == wanted[2]).all()
    assert unwanted[3].all() and unwanted[2, 1] == 0.0 and not unwanted[:2].any()
