import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zsdist.vision.rays import (
    BIN_EDGES_M,
    BINS,
    NEAREST_M,
    RANGE_M,
    RAYS,
    exact_labels,
    quantile_m,
    ray_angles_rad,
    soft_labels,
)


def certain(bin_):
    return np.eye(BINS, dtype=np.float32)[bin_]


def test_rays_run_from_left_to_right_inside_the_view_and_mirror_each_other():
    angles = ray_angles_rad(RAYS, np.pi / 2)
    assert (np.diff(angles) < 0).all() and angles[0] < np.pi / 4
    np.testing.assert_allclose(angles, -angles[::-1], atol=1e-6)


def test_rays_are_equal_pixel_columns():
    np.testing.assert_allclose(np.diff(np.tan(ray_angles_rad(RAYS, np.pi / 2))), -2 / RAYS, atol=1e-5)


def test_edges_grow_by_one_factor_up_to_the_range():
    ratios = BIN_EDGES_M[1:] / BIN_EDGES_M[:-1]
    assert len(BIN_EDGES_M) == BINS and BIN_EDGES_M[-1] == np.float32(RANGE_M)
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-5)


@given(st.floats(0.0, 20.0))
def test_a_soft_label_is_a_distribution_around_the_true_bin(distance):
    label = soft_labels(np.array(distance))
    assert label.sum() == pytest.approx(1, abs=1e-5)
    true_bin = np.clip(np.searchsorted(BIN_EDGES_M, distance, "right") - 1, 0, BINS - 1)
    assert abs(label.argmax() - true_bin) <= 1


@given(st.floats(0.0, 20.0))
def test_an_exact_label_has_all_mass_on_the_bin_that_holds_the_distance(distance):
    label = exact_labels(np.array([distance]))[0]
    (bin_,) = np.flatnonzero(label)
    assert label[bin_] == 1.0 and label.dtype == np.float32
    assert (bin_ == BINS - 1) == (np.float32(distance) >= np.float32(RANGE_M))
    if NEAREST_M < distance < RANGE_M * 0.9999:
        assert BIN_EDGES_M[bin_] <= np.float32(distance) <= BIN_EDGES_M[bin_ + 1]


def test_only_what_is_beyond_the_range_is_free():
    assert soft_labels(np.array(RANGE_M))[-1] == 1.0
    assert soft_labels(np.array(RANGE_M - 0.01))[-1] == 0.0


@given(st.floats(NEAREST_M * 1.2, RANGE_M * 0.85))
def test_the_median_of_a_soft_label_is_near_the_distance(distance):
    assert quantile_m(soft_labels(np.array(distance)), 0.5) == pytest.approx(distance, rel=0.08)


def test_a_low_quantile_finds_the_nearer_of_two_readings():
    either = 0.3 * certain(5) + 0.7 * certain(BINS - 1)
    assert quantile_m(either, 0.2) < BIN_EDGES_M[6]
    assert quantile_m(either, 0.5) == RANGE_M


def test_quantiles_of_one_bin_divide_it_evenly():
    low, high = BIN_EDGES_M[10], BIN_EDGES_M[11]
    assert quantile_m(certain(10), 0.25) == pytest.approx(low + 0.25 * (high - low), rel=1e-5)


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.98))
def test_quantiles_grow_with_their_share(seed, share):
    probabilities = np.random.default_rng(seed).dirichlet(np.full(BINS, 0.2), 4).astype(np.float32)
    assert (quantile_m(probabilities, share) <= quantile_m(probabilities, share + 0.01) + 1e-5).all()


def test_a_share_outside_zero_to_one_is_refused():
    with pytest.raises(ValueError, match="share of a quantile is 1"):
        quantile_m(certain(3), 1)
