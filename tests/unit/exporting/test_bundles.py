import json

import pytest
from bundles import KINEMATIC, small_policy

from zsdist.errors import RunError
from zsdist.exporting.bundles import export_policy
from zsdist.run.policies import SHIPPED


def export(out, **options):
    return export_policy(small_policy(), "small", out, steps=3, simulation=KINEMATIC, **options)


def test_an_export_that_is_interrupted_leaves_nothing(tmp_path):
    def interrupt(what, done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(tmp_path / "bundle", progress=interrupt)
    assert list(tmp_path.iterdir()) == []


def test_an_empty_folder_is_filled_and_others_may_read_it_as_any_file(tmp_path):
    (tmp_path / "any").touch()
    (tmp_path / "bundle").mkdir()
    export(tmp_path / "bundle")
    modes = {path.stat().st_mode for path in (tmp_path / "bundle").iterdir()}
    assert modes == {(tmp_path / "any").stat().st_mode} and (tmp_path / "bundle").stat().st_mode & 0o777 == 0o755


@pytest.mark.parametrize("make", [lambda path: path.write_text(""), lambda path: (path / "x").mkdir(parents=True)])
def test_what_is_there_already_is_not_replaced(tmp_path, make):
    make(tmp_path / "bundle")
    with pytest.raises(RunError, match="exists already; allowed is a new folder, or an empty one"):
        export(tmp_path / "bundle")


def test_the_card_says_what_the_policy_was_trained_and_evaluated_on(small_bundle):
    card, about = (small_bundle / "README.md").read_text(), json.loads((small_bundle / "manifest.json").read_text())
    assert "not proven on hardware" in card and "12 recorded steps" in card
    assert about["trained_on"]["episodes"] == 800
    known = {result["scenes"]: result for result in json.loads((SHIPPED["pretrained"] / "evaluation.json").read_text())}
    assert about["evaluated"].keys() == known.keys() > {"iid", "ood-layout"}
    assert all(round(known[name]["success"], 4) == found["success"] for name, found in about["evaluated"].items())
    assert all(f"| {scenes} |" in card for scenes in about["evaluated"])
