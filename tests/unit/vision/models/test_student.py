import numpy as np
import torch

from zsdist.vision.labels import sectors
from zsdist.vision.models import STUDENT_PX
from zsdist.vision.models.student import Student
from zsdist.vision.rays import BINS, RAYS, ray_angles_rad

FIELD_OF_VIEW_RAD = np.pi / 2


def student():
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return Student(FIELD_OF_VIEW_RAD, (4, 6, 8, 8), 16).eval()


def pictures(count, seed=0):
    shape = (count, STUDENT_PX, STUDENT_PX, 3)
    return torch.from_numpy(np.random.default_rng(seed).integers(0, 256, shape, np.uint8))


def test_outputs_have_the_shapes_of_the_heads_outputs():
    clearance, dynamic, rays, weights = student()(pictures(2))
    assert clearance.shape == (2, 3, BINS) and dynamic.shape == (2, 3) and rays.shape == (2, RAYS, BINS)
    np.testing.assert_allclose(weights.detach().sum(-1), 1, atol=1e-5)


def test_integer_and_float_pictures_give_the_same_outputs():
    for one, other in zip(student()(pictures(1)), student()(pictures(1).float()), strict=True):
        assert torch.equal(one, other)


def test_a_ray_depends_most_on_its_own_column():
    network, images = student(), pictures(1).float().requires_grad_()
    for ray in (4, 16, 27):
        (change,) = torch.autograd.grad(network(images).rays[0, ray].square().sum(), images)
        by_ray = change[0].abs().sum((0, 2)).reshape(RAYS, -1).sum(1)
        assert abs(int(by_ray.argmax()) - ray) <= 2


def test_each_action_attends_to_the_columns_of_its_direction_and_the_margin():
    attended = student()(pictures(1)).attention[0].detach().numpy() > 0
    own = sectors(ray_angles_rad(RAYS, FIELD_OF_VIEW_RAD))
    assert attended[own].all() and not attended[1, RAYS // 2 :].any() and not attended[2, : RAYS // 2].any()


def test_the_default_student_is_small():
    assert sum(value.numel() for value in Student(FIELD_OF_VIEW_RAD).parameters()) < 400_000
