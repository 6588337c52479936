import shutil

import pytest
from bundles import damaged

from zsdist import __version__
from zsdist.errors import BundleError
from zsdist.planning.footprint import CAR_LENGTH_M
from zsdist.planning.grid import Grid
from zsdist.runtime.bundle import FILES, MANIFEST_FILE, Bundle
from zsdist.types import Action


def refusal(folder):
    with pytest.raises(BundleError) as caught:
        Bundle.load(folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_bundle_says_what_its_policy_expects(small_bundle):
    bundle = Bundle.load(small_bundle)
    assert bundle.grid == Grid() and bundle.footprint.length_m == CAR_LENGTH_M
    assert (bundle.camera.width_px, bundle.camera.focal_px, bundle.camera.encoding) == (64, pytest.approx(32.0), "rgb8")
    assert [action.name for action in bundle.actions] == [action.name for action in Action]
    assert [action.turn_deg for action in bundle.actions] == [0, 45, -45, 90, -90]
    assert bundle.config.vision.network == "student" and bundle.manifest.limits.max_steps == 500


def test_a_bundle_names_no_path_of_the_machine_that_made_it(small_bundle):
    words = (small_bundle / MANIFEST_FILE).read_text() + (small_bundle / "README.md").read_text()
    assert str(small_bundle.parent) not in words and "/home" not in words and "/root" not in words


@pytest.mark.parametrize("name", FILES)
def test_a_changed_byte_of_any_file_is_named(small_bundle, tmp_path, name):
    folder = shutil.copytree(small_bundle, tmp_path / "bundle")
    content = bytearray((folder / name).read_bytes())
    content[len(content) // 2] ^= 1
    (folder / name).write_bytes(content)
    assert f"{name} is damaged" in refusal(folder)


@pytest.mark.parametrize("name", [*FILES, MANIFEST_FILE])
def test_a_missing_file_is_named(small_bundle, tmp_path, name):
    folder = shutil.copytree(small_bundle, tmp_path / "bundle")
    (folder / name).unlink()
    assert name in (said := refusal(folder)) and "cannot be read" in said


def test_a_folder_that_is_no_bundle_is_refused(tmp_path):
    assert "zsdist export" in refusal(tmp_path)
    assert "zsdist export" in refusal(tmp_path / "absent")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda about: about.update(format=2), "has the format 2"),
        (lambda about: about.pop("format"), "has the format None"),
        (lambda about: about.update(zsdist="0.0.9"), f"made by zsdist 0.0.9; this is zsdist {__version__}"),
        (lambda about: about.update(colour="red"), "colour"),
        (lambda about: about.pop("camera"), "camera"),
        (lambda about: about["camera"].update(width_px="wide"), "camera.width_px"),
        (lambda about: about["files"].pop("low.onnx"), "no hash of low.onnx"),
        (lambda about: about["files"].update({"../x": "0" * 64}), "'../x'"),
        (lambda about: about["settings"]["agent"].update(option_max_steps=0), "agent.option_max_steps"),
        (lambda about: about["grid"].update(cells=31), "cells"),
    ],
)
def test_a_manifest_of_another_version_or_with_a_wrong_entry_is_refused(small_bundle, tmp_path, change, words):
    assert words in refusal(damaged(small_bundle, tmp_path, change))


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe", b"[" * 100_000])
def test_a_manifest_that_is_no_json_object_is_refused(small_bundle, tmp_path, content):
    folder = shutil.copytree(small_bundle, tmp_path / "bundle")
    (folder / MANIFEST_FILE).write_bytes(content)
    refusal(folder)
