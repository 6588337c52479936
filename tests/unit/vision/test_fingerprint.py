from dataclasses import replace

import pytest

from zsdist.errors import WeightsError
from zsdist.vision.fingerprint import VisionIdentity

TRAINED = VisionIdentity("clip/b", "a" * 64, "head", "b" * 64)


def test_the_same_vision_is_allowed_without_a_message():
    assert TRAINED.check("runs/x", replace(TRAINED)) is None


def test_an_encoder_in_a_folder_of_another_name_is_the_same_one():
    assert TRAINED.check("runs/x", replace(TRAINED, encoder="clip/moved")) is None


@pytest.mark.parametrize("change", [{"encoder": "clip/c", "encoder_sha256": "c" * 64}, {"encoder_sha256": "c" * 64}])
def test_another_encoder_is_refused_naming_both(change):
    here = replace(TRAINED, **change)
    with pytest.raises(WeightsError, match="runs/x was trained on encoder") as refusal:
        TRAINED.check("runs/x", here)
    for one in (TRAINED, here):
        assert one.encoder in str(refusal.value) and one.encoder_sha256[:16] in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_another_head_on_the_same_encoder_is_reported_in_one_line():
    line = TRAINED.check("runs/x", replace(TRAINED, weights_sha256="d" * 64))
    assert "head bbbb" in line and "head dddd" in line and "\n" not in line


@pytest.mark.parametrize("network", ["student", "compact"])
def test_other_weights_of_a_network_without_an_encoder_are_reported_and_one_in_place_of_a_head_is_refused(network):
    alone = VisionIdentity(network, "e" * 64, network, "e" * 64)
    other = replace(alone, encoder_sha256="f" * 64, weights_sha256="f" * 64)
    assert f"{network} eeee" in alone.check("runs/x", other)
    with pytest.raises(WeightsError, match=rf"'clip/b'.*'{network}'"):
        TRAINED.check("runs/x", alone)


def test_an_identity_reads_back_from_json():
    assert VisionIdentity.from_json(TRAINED.to_json()) == TRAINED


@pytest.mark.parametrize("wrong", [None, [], {}, TRAINED.to_json() | {"more": "x"}, TRAINED.to_json() | {"encoder": 3}])
def test_anything_but_an_identity_is_refused(wrong):
    with pytest.raises(ValueError, match="vision is"):
        VisionIdentity.from_json(wrong)
