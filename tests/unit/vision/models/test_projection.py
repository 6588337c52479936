import numpy as np
import pytest
import torch

from zsdist.vision.models.projection import Projection, attended_embeddings, image_embedding, projection_of


@pytest.fixture(scope="module")
def projection():
    torch.manual_seed(0)
    return Projection(features=6, text_width=10).eval()


def test_eq01_the_embedding_of_an_image_is_the_mean_of_its_projected_tokens_at_unit_length():
    projected = torch.zeros(1, 2, 2, 3)
    projected[0, 0, 0], projected[0, 1, 1] = torch.tensor([6.0, 0.0, 0.0]), torch.tensor([0.0, 8.0, 0.0])
    assert image_embedding(projected)[0].tolist() == pytest.approx([0.6, 0.8, 0.0])


def test_an_attended_embedding_depends_on_attended_tokens_alone():
    projected = torch.zeros(1, 2, 2, 3)
    projected[0, 0, 0, 0], projected[0, 1, 1, 1], projected[0, 0, 1, 2] = 6.0, 8.0, 1.0
    attention = torch.tensor([[[1.0, 0, 0, 0], [0, 0, 0, 1.0], [0.5, 0.5, 0, 0]]])
    found = attended_embeddings(projected, attention)
    assert found[0, 0].tolist() == [1, 0, 0] and found[0, 1].tolist() == [0, 1, 0]
    assert found[0, 2].tolist() == pytest.approx([6 / 37**0.5, 0, 1 / 37**0.5])


def test_even_attention_gives_the_embedding_of_the_whole_image(projection):
    projected = projection(torch.randn(2, 5, 5, 6))
    even = torch.full((2, 3, 25), 1 / 25)
    assert torch.allclose(attended_embeddings(projected, even), image_embedding(projected)[:, None], atol=1e-5)


def test_texts_keep_their_direction_at_unit_length(projection):
    texts = torch.nn.functional.normalize(torch.randn(4, 10), dim=-1)
    assert torch.allclose(projection.texts(3 * texts), texts, atol=1e-6)


def test_a_token_is_projected_with_its_neighbours_and_with_no_others(projection):
    tokens = torch.randn(1, 7, 7, 6)
    changed = tokens.clone()
    changed[0, 3, 3] += 1.0
    differs = (projection(tokens) != projection(changed)).any(-1)[0].numpy()
    expected = np.zeros((7, 7), bool)
    expected[2:5, 2:5] = True
    assert differs[3, 3] and not (differs & ~expected).any()


def test_the_mean_of_projected_tokens_is_the_projection_of_the_mean_of_hidden_features(projection):
    tokens = torch.randn(2, 4, 4, 6)
    assert torch.allclose(
        projection(tokens).mean((1, 2)), projection.leave(projection.hidden(tokens).mean((1, 2))), atol=1e-5
    )


def test_a_projection_is_made_from_its_weights_alone(projection):
    again, tokens = projection_of(projection.state_dict()), torch.randn(1, 4, 4, 6)
    assert torch.equal(again(tokens), projection(tokens))


def test_the_default_projection_is_smaller_than_three_megabytes():
    assert sum(4 * value.numel() for value in Projection(112, 384).state_dict().values()) < 3e6
