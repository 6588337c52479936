import json

import pytest

from zsdist.config import CameraConfig
from zsdist.errors import WeightsError
from zsdist.vision import weights_folder
from zsdist.vision.weights_folder import HEAD_FILE, HISTORY_FILE, METADATA_FILE, STUDENT_FILE, VERSION

METADATA = {
    "encoder": {"name": "eye", "sha256": "ab"},
    "camera": {"field_of_view_deg": 90.0, "range_m": 5.0, "height_m": 1.0},
    "seed": 3,
}


class Eye:
    name = "eye"
    sha256 = "ab"


@pytest.fixture
def made(tmp_path):
    return weights_folder.write(tmp_path / "weights", {HEAD_FILE: b"head", STUDENT_FILE: b"student"}, METADATA)


def rewrite(made, change):
    path = made.path / METADATA_FILE
    metadata = json.loads(path.read_text())
    change(metadata)
    path.write_text(json.dumps(metadata))


def test_a_written_folder_reads_back(made):
    found = weights_folder.read(made.path)
    assert found == made and found.content(HEAD_FILE) == b"head" and found.content(STUDENT_FILE) == b"student"
    assert found.metadata["seed"] == 3 and found.metadata["version"] == VERSION


def test_a_second_write_replaces_the_first_and_leaves_the_history(made):
    (made.path / HISTORY_FILE).write_text('{"stage": "head", "epoch": 1}\n')
    again = weights_folder.write(made.path, {HEAD_FILE: b"other"}, METADATA)
    assert again.content(HEAD_FILE) == b"other" and not weights_folder.read(made.path).has(STUDENT_FILE)
    assert again.history() == [{"stage": "head", "epoch": 1}]


def test_the_setting_names_the_shipped_folder_or_a_path(tmp_path):
    assert (
        weights_folder.locate("pretrained") == weights_folder.SHIPPED
        and weights_folder.locate(str(tmp_path)) == tmp_path
    )
    assert weights_folder.read(weights_folder.SHIPPED).content(HEAD_FILE)


def test_a_file_that_the_folder_lacks_is_named_with_those_it_has(made):
    with pytest.raises(WeightsError, match=r"hold no projection\.safetensors, only head\.safetensors, student"):
        made.content(weights_folder.PROJECTION_FILE)


def test_only_the_file_that_is_asked_for_is_read(made):
    (made.path / STUDENT_FILE).unlink()
    found = weights_folder.read(made.path)
    assert found.content(HEAD_FILE) == b"head"
    with pytest.raises(WeightsError, match=r"student\.safetensors cannot be read"):
        found.content(STUDENT_FILE)


def test_a_truncated_and_a_foreign_file_are_refused(made):
    for wrong in (b"hea", b"haed", b""):
        (made.path / HEAD_FILE).write_bytes(wrong)
        with pytest.raises(
            WeightsError, match=rf"head\.safetensors are damaged: {len(wrong)} bytes of SHA-256"
        ) as refused:
            made.content(HEAD_FILE)
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "change",
    [
        lambda metadata: metadata.pop("encoder"),
        lambda metadata: metadata["encoder"].pop("sha256"),
        lambda metadata: metadata["camera"].update(range_m="far"),
        lambda metadata: metadata.pop("files"),
        lambda metadata: metadata.update(files={HEAD_FILE: 4}),
        lambda metadata: metadata.update(files=3),
    ],
)
def test_incomplete_metadata_is_refused(made, change):
    rewrite(made, change)
    with pytest.raises(WeightsError, match=f"{METADATA_FILE} is damaged: no usable entry"):
        weights_folder.read(made.path)


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"sha256": "0"}', '{"version": 1}', "\xff"])
def test_metadata_of_another_version_is_refused(made, text):
    (made.path / METADATA_FILE).write_bytes(text.encode("latin-1"))
    with pytest.raises(WeightsError, match=rf"{METADATA_FILE} is (damaged|of version .*allowed is {VERSION})"):
        weights_folder.read(made.path)


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(WeightsError, match=r"nowhere.*No such file.*'pretrained'"):
        weights_folder.read(tmp_path / "nowhere")


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(WeightsError, match="file cannot be written"):
        weights_folder.write(tmp_path / "file", {HEAD_FILE: b"head"}, METADATA)


def test_a_damaged_history_is_named(made):
    with pytest.raises(WeightsError, match=f"{HISTORY_FILE} cannot be read"):
        made.history()
    (made.path / HISTORY_FILE).write_text("{")
    with pytest.raises(WeightsError, match=f"{HISTORY_FILE} is damaged"):
        made.history()


def trained_on(made, **other):
    return weights_folder.WeightsFolder(made.path, METADATA | {"encoder": METADATA["encoder"] | other})


def test_another_encoder_is_refused_naming_both_and_one_whose_folder_was_renamed_is_not(made):
    made.check_encoder(Eye())
    trained_on(made, name="clip/before").check_encoder(Eye())
    with pytest.raises(WeightsError, match=rf"the encoder 'resnet' with weights cd; the one here is '{Eye.name}'"):
        trained_on(made, name="resnet", sha256="cd").check_encoder(Eye())


def test_a_camera_with_another_relevant_setting_is_refused_and_another_resolution_is_not(made):
    made.check_camera(CameraConfig(size_px=128, forward_m=0.5))
    for key, value in (("field_of_view_deg", 60.0), ("range_m", 8.0), ("height_m", 0.5)):
        with pytest.raises(WeightsError, match=rf"camera\.{key} is {value}; weights .* allow"):
            made.check_camera(CameraConfig(**{key: value}))
