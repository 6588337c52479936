"""Documents: their links and paths exist, and their figures equal the measurements."""

import json
import re
import textwrap
from pathlib import Path

import pytest

from zsdist.reporting.tables import TABLE_4
from zsdist.sim.scenes.scene import read_folder
from zsdist.sim.scenes.solvability import solve

ROOT = Path(__file__).parents[2]
MEASURED = ROOT / "docs" / "measured"
DOCUMENTS = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")]
DOCUMENTS += sorted((ROOT / "docs").glob("*.md"))
ENVIRONMENTS = {"zsdist/CarNavigation-v0"}  # names that look like paths
DRIVING_BASELINES = {
    "potential field, trail and shield": "potential-field",
    "potential field without the trail": "potential-field-no-trail",
    "goal-greedy": "goal-greedy",
    "random": "random",
    "traditional HRL": "traditional-hrl",
    "HRL + vision, three seeds": "hrl-vision",
    "flat DQN, three seeds": "flat-dqn",
    "no merge, three seeds": "no-merge",
    "fixed replay, three seeds": "fixed-replay",
    "no contrastive loss, three seeds": "no-contrast",
    "three directions": "three-directions",
    "`paper.yaml` to the letter": "paper-scattered",
    "A* by our vision": "astar-vision",
    "A*, true distances in 5 m": "astar-frontier",
    "A*, the whole true map": "astar",
}
VISION_SETS = {
    "as in training, new scenes": "same",
    "new kinds of obstacle": "new_kinds",
    "new ground": "new_grounds",
    "new kinds and ground": "both",
    "PyBullet's renderer, street": "other_renderer_urban",
    "PyBullet's renderer, wild": "other_renderer_wild",
}


def rows(document: str, after: str) -> list[list[str]]:
    """Return the cells of the first table after a line, without its head."""
    text = (ROOT / document).read_text().split(after, 1)[1]
    table = re.search(r"((?:^\|.*\|\n)+)", text, re.MULTILINE).group(1)
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]


def measured(name: str) -> dict:
    return json.loads((MEASURED / f"{name}.json").read_text())


def outcomes(name: str, split: str) -> str:
    """Return success and collisions in percent of one policy in one split, as the tables show them."""
    figures = measured(f"driving/{name}-{split}")
    figures = figures.get("interquartile_mean", figures)
    return f"{100 * figures['success']:.1f} / {100 * figures['collision']:.1f}"


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text().split()) <= 800


def test_the_results_of_the_readme_are_those_measured_and_those_of_the_paper():
    for split, *cells, paper in rows("README.md", "## Results"):
        assert cells == [
            outcomes(name, split) for name in ("full", "potential-field", "astar-vision", "astar-frontier")
        ], split
        success, collision = TABLE_4[split][-2:] if split in TABLE_4 else ("", "")
        assert paper == (f"{float(success):.1f} / {float(collision):.1f}" if success else "-"), split


def test_the_baselines_of_the_driving_document_are_those_measured():
    table = {name: cells for name, *cells in rows("docs/driving.md", "## Baselines")}
    splits = ("iid", "ood-start-goal", "ood-layout", "ood-clusters", "ood-dynamic")
    for name, file in DRIVING_BASELINES.items():
        for split, cell in zip(splits, table[name], strict=True):
            figures = measured(f"driving/{file}-{split}")
            spl = figures.get("interquartile_mean", figures).get("spl")
            lengths = "" if spl is None else f" / {spl:.2f}".replace("0.", ".")
            assert cell == outcomes(file, split) + lengths, (name, split)


def test_the_picture_sets_of_the_vision_document_are_those_measured():
    sets = measured("vision-seed31")["sets"]
    table = {name: cells for name, *cells in rows("docs/vision.md", "## Accuracy on sets of pictures")}
    assert set(table) == set(VISION_SETS)
    for name, key in VISION_SETS.items():
        figures = sets[key]
        expected = [f"{figures['best_action_accuracy']:.3f}"]
        expected += [f"{100 * figures[share]:.1f}%" for share in ("miss_rate", "false_alarm_rate", "calibration_10")]
        assert table[name] == expected, name


def test_the_families_of_the_vision_document_are_those_measured():
    check = measured("vision-seed31")
    families = {"all seven": check, **check["families"]}
    columns = ("best_action_accuracy", "regret", "mae", "miss_rate", "false_alarm_rate")
    expected = [[name, *(f"{figures[column]:.3f}" for column in columns)] for name, figures in families.items()]
    assert rows("docs/vision.md", "## Accuracy by test family") == expected


def test_the_architecture_lists_every_folder_of_the_package():
    named = {cells[1].split("`")[1] for cells in rows("docs/architecture.md", "## Folders and layers")}
    folders = {f"zsdist/{path.parent.name}" for path in (ROOT / "zsdist").glob("*/__init__.py")}
    assert folders <= named


def test_the_glossary_explains_each_term_once_and_in_one_sentence():
    lines = (ROOT / "docs" / "glossary.md").read_text().splitlines()
    entries = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| ")]
    entries = [entry for entry in entries if entry[0] != "term"]
    terms = [entry[0] for entry in entries]
    assert len(terms) == len(set(terms)) > 50
    assert [meaning for _, meaning, _ in entries if not meaning.endswith(".") or ". " in meaning] == []


def test_the_index_of_the_glossary_names_every_term_in_alphabetical_order():
    text = (ROOT / "docs" / "glossary.md").read_text()
    index = " ".join(re.search(r"^Index: (.*?)\.$", text, re.MULTILINE | re.DOTALL).group(1).split()).split(", ")
    terms = [cell for cell in re.findall(r"^\| (.+?) \|", text, re.MULTILINE) if cell != "term"]
    names = [name for term in terms for name in re.sub(r" \(.*\)", "", term).split(", ")]
    assert index == sorted(names, key=str.lower)


def test_the_scene_of_the_usage_document_is_valid_and_solvable(tmp_path):
    lines = re.search(r"^    version: 1\n(?:    .*\n)+", (ROOT / "docs" / "usage.md").read_text(), re.MULTILINE).group(
        0
    )
    (tmp_path / "example.yaml").write_text(textwrap.dedent(lines))
    (example,) = read_folder(tmp_path)
    assert solve(example) is not None


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_paths_of_the_checkout_that_are_named_exist(document):
    named = re.findall(r"`((?:zsdist|tests|benchmarks|configs|docs|examples|deploy)/[\w./-]*\w)`", document.read_text())
    assert [path for path in named if not (ROOT / path).exists() and path not in ENVIRONMENTS] == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_modules_and_make_targets_that_are_named_exist(document):
    text = document.read_text()
    modules = {module.replace(".", "/") for module in re.findall(r"python -m (zsdist[\w.]*\w)", text)}
    assert [name for name in modules if not (ROOT / f"{name}.py").exists()] == []
    targets = set(re.findall(r"`make ([\w-]+)", text)) | set(re.findall(r"^    make ([\w-]+)", text, re.MULTILINE))
    assert targets <= set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
