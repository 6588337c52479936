import itertools

import pytest

from zsdist.config import ScenesConfig
from zsdist.errors import SceneError
from zsdist.sim.scenes.families import FAMILIES, draw, generate
from zsdist.sim.scenes.kinds import GROUNDS, KINDS
from zsdist.sim.scenes.manifest import MANIFEST, SPLITS, WITHHELD_GROUNDS, WITHHELD_KINDS, split_seed

TRAINING = ("vision-training", "policy-training", "validation")


@pytest.mark.parametrize("purpose", MANIFEST)
def test_scenes_drawn_for_a_purpose_contain_only_what_the_manifest_allows(purpose):
    entry = MANIFEST[purpose]
    for family in entry.families:
        for index in range(12):
            scene = draw(family, entry.split, index)
            assert {obstacle.kind for obstacle in scene.obstacles} <= set(entry.kinds)
            assert scene.ground in entry.grounds


def test_withheld_kinds_and_grounds_are_in_no_training_and_in_the_test():
    for purpose in TRAINING:
        assert not set(MANIFEST[purpose].kinds) & set(WITHHELD_KINDS)
        assert not set(MANIFEST[purpose].grounds) & set(WITHHELD_GROUNDS)
        assert not any(family.startswith("ood-") for family in MANIFEST[purpose].families)
    assert set(WITHHELD_KINDS) <= set(MANIFEST["test"].kinds)
    assert set(WITHHELD_GROUNDS) <= set(MANIFEST["test"].grounds)


def test_the_vision_model_never_sees_the_policys_commonest_obstacle():
    assert "tree" in MANIFEST["policy-training"].kinds
    assert "tree" not in MANIFEST["vision-training"].kinds


def test_words_have_a_family_of_their_own_that_no_head_trains_on_and_no_test_uses():
    words = MANIFEST["word-training"]
    assert set(words.kinds) == set(KINDS) and set(words.grounds) == set(GROUNDS)
    others = {family for name, entry in MANIFEST.items() if name != "word-training" for family in entry.families}
    assert not set(words.families) & others
    assert words.split != MANIFEST["test"].split
    drawn = [draw("vocabulary", words.split, index) for index in range(30)]
    assert {o.kind for scene in drawn for o in scene.obstacles} == set(KINDS)
    assert {scene.ground for scene in drawn} == set(GROUNDS)


def test_appearance_scenes_show_only_kinds_and_grounds_that_no_training_shows():
    for index in range(12):
        scene = generate("ood-appearance", split_seed("test", index))
        assert {obstacle.kind for obstacle in scene.obstacles} <= set(WITHHELD_KINDS)
        assert scene.ground in WITHHELD_GROUNDS


def test_splits_share_no_seeds():
    for one, other in itertools.combinations(SPLITS.values(), 2):
        assert not range(max(one.start, other.start), min(one.stop, other.stop))
    assert split_seed("train", 0) != split_seed("validation", 0)
    assert all(split_seed(split, 7) in SPLITS[split] for split in SPLITS)


def test_an_unknown_split_or_an_index_out_of_range_is_refused():
    with pytest.raises(SceneError, match="allowed are train, validation, test"):
        split_seed("holdout", 0)
    for index in (-1, 1_000_000):
        with pytest.raises(SceneError, match="allowed is 0 to 999999"):
            split_seed("test", index)


def test_the_manifest_names_only_existing_things_and_the_default_configuration_agrees_with_it():
    for entry in MANIFEST.values():
        assert set(entry.families) <= set(FAMILIES)
        assert set(entry.kinds) <= set(KINDS) and set(entry.grounds) <= set(GROUNDS)
        assert entry.split in SPLITS
    assert set(ScenesConfig().train) <= set(MANIFEST["policy-training"].families)
    assert set(ScenesConfig().test) <= set(MANIFEST["test"].families)


def test_kinds_have_their_own_segment_number_and_either_a_radius_or_a_size():
    assert len({kind.segment_id for kind in KINDS.values()} | {0, 1, 2}) == len(KINDS) + 3
    assert {kind.name for kind in KINDS.values() if not kind.round} == {"box", "car"}
    assert [kind.name for kind in KINDS.values() if kind.dynamic] == ["person"]
    assert KINDS["tree"].default_radius_m == 1.0
