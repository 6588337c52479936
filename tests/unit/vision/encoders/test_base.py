import numpy as np
import pytest

from zsdist.errors import WeightsError
from zsdist.vision.encoders import open_encoder
from zsdist.vision.encoders.base import similarity, unit


def test_eq02_similarity_is_the_cosine_for_any_lengths():
    a = np.array([[3.0, 0.0], [1.0, 1.0]])
    b = np.array([[2.0, 0.0], [0.0, 5.0], [-1.0, -1.0]])
    half = np.sqrt(0.5)
    np.testing.assert_allclose(similarity(a, b), [[1, 0, -half], [half, half, -1]], atol=1e-12)


def test_eq02_similarity_of_rows_is_the_quotient_that_the_paper_writes():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(4, 7)), rng.normal(size=(3, 7))
    for i, row in enumerate(a):
        for j, other in enumerate(b):
            cosine = row @ other / (np.linalg.norm(row) * np.linalg.norm(other))
            assert similarity(a, b)[i, j] == pytest.approx(cosine)


@pytest.mark.parametrize(("a", "b"), [((2, 3), (2, 4)), ((3,), (2, 3)), ((2, 3), (3,))])
def test_rows_of_different_widths_are_refused_with_both_shapes(a, b):
    with pytest.raises(ValueError, match=r"allowed are \(N, D\) and \(M, D\)"):
        similarity(np.ones(a), np.ones(b))


@pytest.mark.parametrize("vector", [[0.0, 0.0], [np.nan, 1.0], [np.inf, 1.0]])
def test_a_vector_without_direction_is_refused(vector):
    with pytest.raises(ValueError, match="no direction"):
        unit(np.array([[1.0, 0.0], vector]))


def test_an_unknown_encoder_is_refused_with_the_allowed_values(tmp_path):
    with pytest.raises(WeightsError, match=r"'resnet'.*efficientnet-lite0.*CLIP"):
        open_encoder("resnet")
