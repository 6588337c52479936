import math

import numpy as np
import pytest
import torch

from zsdist.vision.rays import soft_labels
from zsdist.vision.training.losses import (
    action_losses,
    attention_error,
    contrastive_loss,
    distance_loss,
    kind_loss,
    total_loss,
)


def logits_of(distance):
    return torch.from_numpy(np.log(soft_labels(np.array(distance)) + 1e-6))


def test_the_loss_of_an_action_is_the_norm_of_its_own_errors():
    predicted, labels = torch.zeros(4, 3), torch.zeros(4, 3)
    labels[:, 1] = 2.0
    assert action_losses(predicted, labels).tolist() == pytest.approx([0, 2, 0], abs=1e-3)


def test_the_loss_of_an_action_has_a_gradient_where_there_is_no_error():
    predicted = torch.zeros(4, 3, requires_grad=True)
    action_losses(predicted, torch.zeros(4, 3)).sum().backward()
    assert torch.isfinite(predicted.grad).all()


def test_the_right_distance_costs_least_and_a_far_one_more_than_a_near_one():
    label = torch.from_numpy(soft_labels(np.array([1.0])))
    right, near, far = (distance_loss(logits_of([metres]), label) for metres in (1.0, 1.6, 4.5))
    assert right < near < far


def test_the_nearer_of_two_equally_unlikely_predictions_costs_less():
    label = torch.from_numpy(soft_labels(np.array([1.0])))
    near, far = torch.full((1, 25), -20.0), torch.full((1, 25), -20.0)
    near[0, 16], far[0, 22] = 20.0, 20.0
    assert distance_loss(near, label) < distance_loss(far, label)


def test_the_kind_counts_only_in_directions_with_an_obstacle():
    logits, dynamic = torch.tensor([[9.0, -9.0, 9.0]]), torch.tensor([[1.0, 0.0, 0.0]])
    assert kind_loss(logits, dynamic, torch.tensor([[True, True, False]])) < 0.01
    assert kind_loss(logits, dynamic, torch.tensor([[True, True, True]])) > 1
    assert kind_loss(logits, dynamic, torch.zeros(1, 3, dtype=torch.bool)) == 0


def directions(*degrees):
    """Return unit vectors in the plane, `(len, 2)`."""
    angle = torch.deg2rad(torch.tensor(degrees, dtype=torch.float32))
    return torch.stack([angle.cos(), angle.sin()], -1)


def marks(*rows):
    """Return `(1, 3, M)` bool from a row of 0 and 1 for each action."""
    return torch.tensor([rows], dtype=torch.bool)


def test_eq05_the_total_is_the_sum_over_the_actions_plus_lambda_times_the_contrast():
    of_actions, contrast = torch.tensor([0.1, 0.2, 0.3]), torch.tensor(2.0)
    assert float(total_loss(of_actions, contrast, 0.25)) == pytest.approx(1.1)
    assert float(total_loss(of_actions, contrast, 0.0)) == pytest.approx(0.6)


def test_eq06_is_the_papers_formula_for_one_positive_and_several_negative_samples():
    anchor, tau = directions(20, 0, 0)[None], 0.5
    samples = directions(50, 110, 170)[None]
    found = contrastive_loss(
        anchor, torch.zeros(1, 2), samples, marks([1, 0, 0], [0] * 3, [0] * 3), marks([0, 1, 1], [0] * 3, [0] * 3),
        torch.ones(1, 3), "literal", tau,
    )  # fmt: skip
    right, *wrong = (math.exp(math.cos(math.radians(angle)) / tau) for angle in (30, 90, 150))
    assert float(found) == pytest.approx(-math.log(right / (right + sum(wrong))), rel=1e-5)


def test_eq06_the_difference_form_pulls_an_action_to_the_hidden_object_and_the_literal_form_away():
    thing, other = torch.tensor([1.0, 0.0, 0.0]), torch.tensor([0.0, 1.0, 0.0])
    whole = thing + other + torch.tensor([0.0, 0.0, 1.0])
    masked = torch.stack([whole - thing, whole - other])[None]

    def at(anchor, form):
        anchors = anchor.expand(1, 3, 3)
        positive, negative = marks([1, 0], [0, 0], [0, 0]), marks([0, 1], [1, 1], [1, 1])
        return contrastive_loss(anchors, whole[None], masked, positive, negative, torch.ones(1, 2), form)

    assert at(thing, "difference") < 0.01 < at(other, "difference")
    assert at(thing, "literal") > at(other, "literal")


def test_a_sample_of_the_background_counts_less():
    samples, positive, negative = directions(0, 30)[None], marks([1, 0], [0, 0], [0, 0]), marks([0, 1], [0, 0], [0, 0])

    def weighed(weight):
        anchors = directions(0, 0, 0)[None]
        return contrastive_loss(
            anchors, torch.zeros(1, 2), samples, positive, negative, torch.tensor([[1.0, weight]]), "literal"
        )

    assert 0 < weighed(0.2) < weighed(1.0)
    assert weighed(0.0) == pytest.approx(0, abs=1e-4)


def test_an_action_without_positive_or_negative_samples_is_skipped():
    anchors = directions(20, 80, 140)[None].requires_grad_()
    samples, weight = directions(0, 90)[None], torch.ones(1, 2)
    positive, negative = marks([1, 0], [0, 0], [1, 1]), marks([0, 1], [1, 1], [0, 0])
    alone = contrastive_loss(anchors, torch.zeros(1, 2), samples, positive, negative, weight, "literal")
    (gradient,) = torch.autograd.grad(alone, anchors)
    assert (gradient[0, 0] != 0).any() and (gradient[0, 1:] == 0).all()
    nothing = contrastive_loss(anchors, torch.zeros(1, 2), samples, positive & False, negative, weight, "literal")
    assert float(nothing.detach()) == 0
    assert (torch.autograd.grad(nothing, anchors)[0] == 0).all()


def test_the_attention_error_is_small_on_wanted_tokens_and_grows_on_unwanted_ones():
    wanted = torch.zeros(1, 3, 4)
    wanted[0, 0, 1] = 1.0  # the two other actions have no wanted tokens
    unwanted = torch.tensor([[0.0, 0.0, 0.0, 1.0]])

    def error(first, others):
        return float(attention_error(torch.tensor([[first, others, others]]), wanted, unwanted))

    elsewhere = [1.0, 0.0, 0.0, 0.0]
    assert error([0.0, 1.0, 0.0, 0.0], elsewhere) == pytest.approx(0.0, abs=1e-6)
    assert error([0.5, 0.5, 0.0, 0.0], elsewhere) == pytest.approx(math.log(2), abs=1e-5)
    assert error([0.0, 1.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.5]) == pytest.approx(2 / 3 * math.log(2), abs=1e-5)
