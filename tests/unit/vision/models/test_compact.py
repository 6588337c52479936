import numpy as np
import torch

from zsdist.vision.labels import sectors
from zsdist.vision.models import COMPACT_PX, COMPACT_ROWS
from zsdist.vision.models.compact import PATCH_PX, Compact
from zsdist.vision.rays import BINS, RAYS, ray_angles_rad

FIELD_OF_VIEW_RAD = np.pi / 2


def compact(*sizes):
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return Compact(FIELD_OF_VIEW_RAD, *(sizes or ((4, 6, 8), 16))).eval()


def pictures(count, rows=COMPACT_PX, seed=0):
    shape = (count, rows, COMPACT_PX, 3)
    return torch.from_numpy(np.random.default_rng(seed).integers(0, 256, shape, np.uint8))


def test_outputs_have_the_shapes_of_the_heads_outputs():
    clearance, dynamic, rays, weights = compact()(pictures(2))
    assert clearance.shape == (2, 3, BINS) and dynamic.shape == (2, 3) and rays.shape == (2, RAYS, BINS)
    np.testing.assert_allclose(weights.detach().sum(-1), 1, atol=1e-5)


def test_a_whole_picture_and_its_lowest_rows_give_the_same_outputs():
    network, whole = compact(), pictures(2)
    for one, other in zip(network(whole), network(whole[:, -COMPACT_ROWS:].float()), strict=True):
        assert torch.equal(one, other)


def test_each_ray_lies_on_the_middle_column_of_its_own_patches():
    angles = ray_angles_rad(RAYS, FIELD_OF_VIEW_RAD)
    columns = np.arctan(1 - 2 * (np.arange(COMPACT_PX) + 0.5) / COMPACT_PX)
    np.testing.assert_allclose(columns[PATCH_PX // 2 :: PATCH_PX], angles, atol=1e-6)


def test_a_ray_depends_most_on_its_own_columns():
    network, images = compact(), pictures(1).float().requires_grad_()
    for ray in (4, 16, 27):
        (change,) = torch.autograd.grad(network(images).rays[0, ray].square().sum(), images)
        by_ray = change[0].abs().sum((0, 2)).reshape(RAYS, -1).sum(1)
        assert abs(int(by_ray.argmax()) - ray) <= 2


def test_each_action_attends_to_the_columns_of_its_direction_and_the_margin():
    attended = compact()(pictures(1)).attention[0].detach().numpy() > 0
    own = sectors(ray_angles_rad(RAYS, FIELD_OF_VIEW_RAD))
    assert attended[own].all() and not attended[1, RAYS // 2 :].any() and not attended[2, : RAYS // 2].any()


def test_the_default_network_costs_a_fraction_of_the_encoder():
    done = []

    def count(layer, inputs, output):
        done.append(layer.weight.numel() * output[0, 0].numel())

    network = Compact(FIELD_OF_VIEW_RAD).eval()
    for layer in network.modules():
        if isinstance(layer, (torch.nn.Conv1d, torch.nn.Conv2d)):
            layer.register_forward_hook(count)
    network(pictures(1))
    assert 30e6 < sum(done) < 60e6  # multiply-adds; the encoder makes 243 million
