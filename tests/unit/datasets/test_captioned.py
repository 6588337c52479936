import numpy as np
import pytest

from zsdist.config import CameraConfig
from zsdist.datasets.captioned import CELLS, captioned_views, cell_shares, describe, dominant_kind
from zsdist.errors import SceneError
from zsdist.sim.scenes.kinds import GROUNDS, KINDS, SEGMENT_GROUND, SEGMENT_SKY
from zsdist.vision.words.vocabulary import CONCEPTS, GROUND_WORDS, KIND_WORDS

CAMERA = CameraConfig(size_px=64)


def views(count=10, seed=5, split="vision", **options):
    return list(captioned_views(["vocabulary"], split, count, seed, CAMERA, **options))


def test_concepts_are_the_kinds_the_grounds_the_wall_and_the_sky():
    assert set(KIND_WORDS) == set(KINDS) and set(GROUND_WORDS) == set(GROUNDS)
    assert set(CONCEPTS[: len(KINDS)]) == set(KINDS)
    assert set(CONCEPTS) - set(KINDS) - set(GROUNDS) == {"wall", "sky"}


@pytest.mark.parametrize("varied", [False, True])
def test_a_view_has_the_shares_of_concepts_in_each_cell(varied):
    for view in views(varied=varied):
        assert view.image.shape == (64, 64, 3) and view.image.dtype == np.uint8
        assert view.cells.shape == (CELLS, CELLS, len(CONCEPTS))
        assert np.allclose(view.cells.sum(-1, dtype=np.float32), 1, atol=0.01)
        assert CONCEPTS[view.ground] in GROUNDS
        others = [CONCEPTS.index(name) for name in GROUNDS if name != CONCEPTS[view.ground]]
        assert not view.cells[..., others].any()
        assert -1 <= view.dominant < len(KINDS)


def test_the_same_arguments_give_the_same_views_and_splits_share_no_scene():
    once, again = views(varied=True), views(varied=True)
    assert all((a.image == b.image).all() and a.caption == b.caption for a, b in zip(once, again, strict=True))
    assert views(seed=6)[0].scene_hash != once[0].scene_hash
    assert not {v.scene_hash for v in once} & {v.scene_hash for v in views(split="test")}
    with pytest.raises(SceneError, match="holiday"):
        views(split="holiday")


def test_a_rock_on_the_left_of_a_meadow_is_described_so():
    segments = np.full((56, 56), SEGMENT_GROUND, np.uint8)
    segments[:20] = SEGMENT_SKY
    segments[16:40, 2:18] = KINDS["rock"].segment_id
    cells, sentence, dominant = describe(segments, "grass", np.random.default_rng(0))
    assert CONCEPTS[dominant] == "rock"
    assert CONCEPTS[cells[6, 2].argmax()] == "rock" and CONCEPTS[cells[-1, -1].argmax()] == "grass"
    assert CONCEPTS[cells[0, 0].argmax()] == "sky"
    assert any(word in sentence for word in KIND_WORDS["rock"].training) and "left" in sentence


def test_cells_may_have_unequal_numbers_of_pixels():
    concepts = np.zeros((30, 30), np.int64)
    concepts[:, 15:] = 1
    shares = cell_shares(concepts, 14)
    assert (shares[:, :7, 0] == 1).all() and (shares[:, 7:, 1] == 1).all()


def test_a_dominant_kind_covers_enough_and_twice_as_much_as_any_other():
    assert dominant_kind(np.array([0.1, 0.02, 0.0])) == 0
    assert dominant_kind(np.array([0.1, 0.06, 0.0])) == -1
    assert dominant_kind(np.array([0.0, 0.05, 0.0])) == -1
