import numpy as np
import pytest
import torch

from zsdist.vision.rays import soft_labels
from zsdist.vision.training.losses import action_losses, distance_loss, kind_loss


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


def test_order_counts_between_two_answers_that_are_equally_unlikely():
    label = torch.from_numpy(soft_labels(np.array([1.0])))
    near, far = torch.full((1, 25), -20.0), torch.full((1, 25), -20.0)
    near[0, 16], far[0, 22] = 20.0, 20.0
    assert distance_loss(near, label) < distance_loss(far, label)


def test_the_kind_counts_only_where_there_is_an_obstacle():
    logits, dynamic = torch.tensor([[9.0, -9.0, 9.0]]), torch.tensor([[1.0, 0.0, 0.0]])
    assert kind_loss(logits, dynamic, torch.tensor([[True, True, False]])) < 0.01
    assert kind_loss(logits, dynamic, torch.tensor([[True, True, True]])) > 1
    assert kind_loss(logits, dynamic, torch.zeros(1, 3, dtype=torch.bool)) == 0
