import json
from itertools import pairwise

import pytest

from zsdist.common import atomic_files
from zsdist.run import figures_file
from zsdist.run.figures_file import DENSE_ROWS, THINNED_AFTER_ROWS, FiguresFile, spacing


def numbers(path):
    return [json.loads(line)["row"] for line in path.read_text().splitlines()]


def filled(path, rows):
    file = FiguresFile(path)
    for number in range(rows):
        file.append({"episodes": number})
    return file


def test_new_rows_are_all_kept_and_old_ones_ever_further_apart(tmp_path):
    path, rows = tmp_path / "metrics.jsonl", 16 * THINNED_AFTER_ROWS
    filled(path, rows)
    kept = numbers(path)
    assert kept == sorted(kept) and kept[0] == 0
    assert kept[-DENSE_ROWS:] == list(range(rows - DENSE_ROWS, rows))
    gaps = [(later - one, rows - one) for one, later in pairwise(kept)]
    assert all(gap <= max(1, 2 * age / DENSE_ROWS) for gap, age in gaps)
    assert len(kept) < 9 * DENSE_ROWS


def test_a_row_that_is_kept_later_was_kept_before():
    assert all(spacing(age + 1, 100) % spacing(age, 100) == 0 for age in range(20_000))
    assert [spacing(age, 100) for age in (0, 199, 200, 399, 400, 10**9)] == [1, 1, 2, 2, 4, 2**23]


def test_rows_continue_after_a_reopening_as_if_there_had_been_none(tmp_path):
    once, twice = tmp_path / "once.jsonl", tmp_path / "twice.jsonl"
    filled(once, 3 * THINNED_AFTER_ROWS)
    filled(twice, 2 * THINNED_AFTER_ROWS + 5)
    file = FiguresFile(twice)
    for number in range(2 * THINNED_AFTER_ROWS + 5, 3 * THINNED_AFTER_ROWS):
        assert file.append({"episodes": number}) == number
    assert once.read_bytes() == twice.read_bytes()


def test_a_rewound_file_grows_as_if_nothing_had_been_cut_off_even_where_it_was_thinned_since(tmp_path):
    once, twice, rows = tmp_path / "once.jsonl", tmp_path / "twice.jsonl", 3 * THINNED_AFTER_ROWS
    filled(once, rows + 9)
    at_the_checkpoint = filled(twice, rows - 5).rows
    later = FiguresFile(twice)
    for _ in range(8):
        later.append({"episodes": at_the_checkpoint})  # of the episodes finished by then: only its number is later
    figures_file.rewind(twice, at_the_checkpoint, at_the_checkpoint)
    file = FiguresFile(twice)
    for number in range(rows - 5, rows + 9):
        assert file.append({"episodes": number}) == number
    assert once.read_bytes() == twice.read_bytes()


def test_a_rewound_file_of_an_earlier_version_keeps_the_rows_up_to_the_episodes_of_the_checkpoint(tmp_path):
    path = tmp_path / "metrics.jsonl"
    filled(path, 20)
    figures_file.rewind(path, 7, None)
    assert numbers(path) == list(range(8))


def test_a_reader_that_has_the_file_open_reads_whole_lines_on(tmp_path):
    path = tmp_path / "metrics.jsonl"
    file = filled(path, 3 * THINNED_AFTER_ROWS - 1)
    with path.open() as reader:
        file.append({})  # thins
        assert [json.loads(line)["row"] for line in reader][-1] == 3 * THINNED_AFTER_ROWS - 1
    file.append({})
    assert numbers(path)[-1] == 3 * THINNED_AFTER_ROWS


def test_a_crash_while_thinning_leaves_all_rows(tmp_path, monkeypatch):
    path = tmp_path / "metrics.jsonl"
    file = filled(path, 3 * THINNED_AFTER_ROWS - 1)
    monkeypatch.setattr(atomic_files, "sync_folder", lambda folder: None)
    monkeypatch.setattr(type(path), "replace", lambda self, target: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        file.append({})
    monkeypatch.undo()
    assert numbers(path)[-1] == 3 * THINNED_AFTER_ROWS - 1
    again = FiguresFile(path)
    for _ in range(THINNED_AFTER_ROWS):
        last = again.append({})
    assert numbers(path)[-1] == last and [entry.name for entry in tmp_path.iterdir()] == ["metrics.jsonl"]


def test_a_file_of_an_earlier_version_is_continued_and_thinned(tmp_path):
    path, rows = tmp_path / "metrics.jsonl", 2 * THINNED_AFTER_ROWS - 1
    path.write_text("".join(json.dumps({"episodes": number}) + "\n" for number in range(rows)) + "nonsense\n")
    file = FiguresFile(path)
    assert file.append({}) == 2 * THINNED_AFTER_ROWS
    for _ in range(THINNED_AFTER_ROWS):
        file.append({})
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert len(lines) < 6 * DENSE_ROWS
    assert lines[0] == {"episodes": 0} and lines[-1]["row"] == 3 * THINNED_AFTER_ROWS
