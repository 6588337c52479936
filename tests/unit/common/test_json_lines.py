import json

import pytest

from zsdist.common import json_lines


def test_stale_and_unfinished_lines_are_removed_and_the_others_kept_byte_for_byte(tmp_path):
    file = tmp_path / "training.jsonl"
    lines = [{"stage": stage, "epoch": epoch} for stage in ("words", "head") for epoch in (1, 2, 3)]
    texts = [json.dumps(line, separators=(",", " : ")) + "\n" for line in lines]
    file.write_text("".join(texts) + '{"stage": "he')
    json_lines.prune(file, lambda line: line["stage"] == "head" and line["epoch"] > 1)
    assert file.read_text() == "".join(texts[:4])


def test_lines_without_the_key_that_decides_are_removed(tmp_path):
    file = tmp_path / "episodes.jsonl"
    file.write_text('{"episode": 1}\n{"other": 1}\n')
    json_lines.prune(file, lambda record: record["episode"] > 1)
    assert file.read_text() == '{"episode": 1}\n'


def test_a_file_that_does_not_exist_is_not_made(tmp_path):
    json_lines.prune(tmp_path / "none.jsonl", lambda record: True)
    assert list(tmp_path.iterdir()) == []


def test_a_cut_removes_what_follows_the_last_object_that_belongs(tmp_path):
    file = tmp_path / "episodes.jsonl"
    lines = [json.dumps({"number": number, "text": "x" * (number * 977 % 3000)}) + "\n" for number in range(200)]
    for last in (199, 150, 3, 0):
        file.write_text("".join(lines) + '{"number": 1')
        json_lines.cut(file, lambda record, last=last: record["number"] <= last)
        assert file.read_text() == "".join(lines[: last + 1])


def test_a_cut_of_a_file_in_which_nothing_belongs_leaves_it_empty(tmp_path):
    file = tmp_path / "episodes.jsonl"
    file.write_bytes(b'{"number": 5}\n\x00\x00\nnonsense\n[]\n{"other": 1}\n'.replace(b"[]\n", b""))
    json_lines.cut(file, lambda record: record["number"] < 5)
    assert file.read_bytes() == b""
    json_lines.cut(tmp_path / "none.jsonl", lambda record: True)
    assert not (tmp_path / "none.jsonl").exists()


@pytest.mark.parametrize("block", [1, 2, 7, 65_536])
def test_lines_are_read_backwards_with_their_ends(tmp_path, monkeypatch, block):
    monkeypatch.setattr(json_lines, "BLOCK_BYTES", block)
    file = tmp_path / "lines"
    file.write_bytes(b"one\n\nthree\nunfinished")
    assert list(json_lines.backwards(file)) == [(11, b"three\n"), (5, b"\n"), (4, b"one\n")]
    file.write_bytes(b"")
    assert list(json_lines.backwards(file)) == []
