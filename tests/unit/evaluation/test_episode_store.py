import dataclasses
import json

import pytest
from fakes import RECORD

from zsdist.config import Config, load
from zsdist.errors import RunError
from zsdist.evaluation import episode_store
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.episode_store import EpisodeStore
from zsdist.evaluation.fingerprint import code_sha256
from zsdist.sim.scenes import families

ASTAR = Contender(Config(), baseline="astar")
SCENES = [families.draw("iid", "test", index) for index in range(3)]


def opened(file, contender=ASTAR, seed=0, chosen=SCENES, policy="astar", scenes="iid", **options):
    return EpisodeStore(file, contender, policy, None, scenes, seed, list(chosen), **options)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "episodes.jsonl"
    store = opened(path)
    store.add(0, RECORD)
    store.add(2, dataclasses.replace(RECORD, steps=7))
    return path


def test_written_episodes_are_known_again(file):
    again = opened(file)
    assert again.known == {0: RECORD, 2: dataclasses.replace(RECORD, steps=7)} and again.stale == 0


def test_fewer_scenes_use_the_known_episodes_among_them(file):
    assert list(opened(file, chosen=SCENES[:2]).known) == [0]


def test_other_code_makes_lines_stale(file, monkeypatch):
    monkeypatch.setattr(episode_store, "code_sha256", lambda: "another")
    assert (opened(file).known, opened(file).stale) == ({}, 2)


def test_lines_of_code_that_is_listed_as_equivalent_are_known_and_new_ones_name_the_code_in_use(
    file, tmp_path, monkeypatch
):
    newer = "0123456789abcdef"
    listed, unlisted = tmp_path / "listed.yaml", tmp_path / "unlisted.yaml"
    entry = '- {{commit: 1a2b3c4, hashes: ["{}", "{}"], proof: equal episodes}}'
    listed.write_text(entry.format(code_sha256(), newer))
    unlisted.write_text(entry.format("f" * 16, newer))
    monkeypatch.setattr(episode_store, "code_sha256", lambda: newer)
    resumed, refused = opened(file, equivalents=listed), opened(file, equivalents=unlisted)
    assert (list(resumed.known), resumed.stale) == ([0, 2], 0)
    assert (list(refused.known), refused.stale) == ([], 2)
    resumed.add(1, RECORD)
    assert [line.about["code"] for line in episode_store.read(file)] == [code_sha256(), code_sha256(), newer]


def test_other_settings_make_lines_stale(file):
    contender = Contender(load(overrides=("sim.max_steps=20",)), baseline="astar")
    assert (opened(file, contender).known, opened(file, contender).stale) == ({}, 2)


def test_lines_of_other_policies_scenes_and_seeds_are_neither_known_nor_stale(file):
    others = (
        opened(file, Contender(Config(), baseline="random"), policy="random"),
        opened(file, seed=1),
        opened(file, scenes="ood-layout", chosen=[families.draw("ood-layout", "test", 0)]),
    )
    assert [(store.known, store.stale) for store in others] == [({}, 0)] * 3


def test_a_line_that_was_cut_off_is_removed(file):
    with file.open("a") as out:
        out.write('{"code": "abc')
    assert len(opened(file).known) == 2
    opened(file).add(1, RECORD)
    assert len(opened(file).known) == 3


def test_reading_does_not_change_a_file_whose_last_line_is_incomplete(file):
    with file.open("a") as out:
        out.write('{"code": "abc')
    before = file.read_bytes()
    assert len(episode_store.read(file)) == 2
    assert file.read_bytes() == before


@pytest.mark.parametrize("content", ["seed: 1", '{"ended": "complete"\n}', "line 1\nlast line", '{"code": 7'])
def test_a_file_with_other_content_and_no_last_newline_is_refused_and_not_changed(tmp_path, content):
    file = tmp_path / "other"
    file.write_text(content)
    with pytest.raises(RunError, match=r"(not|does not end with) an episode of an evaluation"):
        opened(file)
    assert file.read_text() == content


@pytest.mark.parametrize(
    ("name", "value"),
    [("index", "1"), ("index", -1), ("steps", "many"), ("poses", [["a", 0, 0]]), ("path_m", float("nan"))],
)
def test_a_line_with_an_impossible_value_is_refused(file, name, value):
    line = json.loads(file.read_text().splitlines()[0])
    file.write_text(json.dumps(line | {name: value}) + "\n")
    with pytest.raises(RunError, match="line 1 is not an episode"):
        episode_store.read(file)


@pytest.mark.parametrize("line", ["{}", "nonsense", "[1, 2]", '{"outcome": "victory"}'])
def test_a_file_with_other_content_is_refused_with_the_number_of_its_line(tmp_path, line):
    file = tmp_path / "other.jsonl"
    file.write_text(line + "\n")
    with pytest.raises(RunError, match=r"other\.jsonl, line 1 is not an episode"):
        opened(file)
